"""Brings a node too far behind for blocks to a snapshot's state, on restart."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

import structlog

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from node.snapshot.checking import ProvenHead
from node.snapshot.fetching import Requester, SnapshotFetcher
from node.snapshot.restoring import build_aside, discard_restored
from node.snapshot.snapshot_format import SnapshotFolder
from node.storage.ledger_store import Position

RETRY_MS = 5_000
BLAMED_CODES = frozenset({"SNAPSHOT_DAMAGED", "SNAPSHOT_UNPROVEN", "SNAPSHOT_OTHER_CHAIN", "SNAPSHOT_VERSION"})
"""Why a fetched snapshot is refused by its maker's fault, and not because of this node's disk or progress."""

log = structlog.get_logger(__name__)


class _StoppedError(Exception):
    """The node stops while a ledger is being built."""


class SyncGap(Protocol):
    """How far the node is behind, by its synchroniser."""

    def snapshot_peers(self, lag_max: int) -> tuple[list[str], int]:
        """Return peers (empty while blocks suffice) and the snapshot's minimum height."""
        ...

    @property
    def position(self) -> Position: ...


class SnapshotJoiner:
    """Fetches a snapshot if blocks do not suffice; `restart` requests the node's restart.

    `lag_max`: blocks behind before preferring a snapshot (0: never preferred).
    """

    def __init__(
        self,
        *,
        genesis: Genesis,
        requester: Requester,
        gap: SyncGap,
        ledger_dir: Path,
        folder: Path,
        lag_max: int,
        restart: Callable[[], None],
    ) -> None:
        self._genesis = genesis
        self._gap = gap
        self._ledger_dir = ledger_dir
        self._lag_max = lag_max
        self._restart = restart
        self._fetcher = SnapshotFetcher(genesis, requester, folder)
        self._task: asyncio.Task[None] | None = None
        self._building: asyncio.Future[ProvenHead] | None = None
        self._stopping = threading.Event()
        self._is_done = False

    def start_if_behind(self) -> None:
        if self._is_done or (self._task is not None and not self._task.done()):
            return
        peers, above_height = self._gap.snapshot_peers(self._lag_max)
        if peers:
            self._task = asyncio.get_running_loop().create_task(self._join(peers, above_height), name="join")

    async def stop(self) -> None:
        """Stop after the build ends; fetched chunks stay, an unfinished ledger does not."""
        self._stopping.set()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        if self._building is not None:
            await asyncio.gather(self._building, return_exceptions=True)

    def _go_on(self, _chunks: int, _size_bytes: int) -> None:
        if self._stopping.is_set():
            raise _StoppedError

    async def _join(self, peers: list[str], above_height: int) -> None:
        try:
            source = await self._fetcher.fetch(peers, above_height)
        except (BlockRobotError, OSError) as error:
            log.warning("snapshot_not_fetched", detail=str(error))
            await asyncio.sleep(RETRY_MS / 1000)
            return
        head = await self._build(source)
        if head is None:
            await asyncio.sleep(RETRY_MS / 1000)
            return
        self._fetcher.drop(source)
        if self._gap.position.height >= head.header.height:
            log.info("snapshot_superseded", height=head.header.height)
            await asyncio.get_running_loop().run_in_executor(None, discard_restored, self._ledger_dir)
            return
        self._is_done = True
        log.warning("snapshot_ready", height=head.header.height)
        self._restart()

    async def _build(self, source: SnapshotFolder) -> ProvenHead | None:
        stored, place = self._gap.position, self._ledger_dir
        work = partial(build_aside, source, self._genesis, place, self._go_on, stored=stored)
        self._building = asyncio.get_running_loop().run_in_executor(None, work)
        try:
            return await asyncio.shield(self._building)
        except BlockRobotError as error:
            log.error("snapshot_refused", code=error.code, detail=error.detail)
            if error.code in BLAMED_CODES:
                self._fetcher.forget(source)
                return None
        except OSError as error:
            log.error("snapshot_not_built", detail=str(error))
        self._fetcher.drop(source)
        return None
