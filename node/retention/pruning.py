"""Drops the bodies of old blocks (`retention.py`); headers, places, txids, proofs and state stay."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from consensus.errors import BlockRobotError
from node.config import KEEP_BLOCKS_MIN_COUNT, NodeConfig
from node.custody.stores.open_store import open_store
from node.retention.retention import HeldBy, Retention, highest_prunable
from node.snapshot.making import header_of_block
from node.storage.ledger_store import LedgerStore
from node.storage.lmdb_store import LmdbStore

REQUEST_FILE_NAME = "prune.request"
PRUNE_SLACK_COUNT = 64
"""A running node prunes this many blocks at once, or none."""

log = structlog.get_logger(__name__)


async def prune_ledger(ledger: LedgerStore, below_height: int) -> int:
    """Prune stepwise, yielding in between; return the earliest height with a body."""
    while True:
        earliest = await ledger.prune(below_height, header_of_block)
        position = ledger.position
        if earliest >= min(below_height, 0 if position is None else position.height):
            return earliest
        await asyncio.sleep(0)


class Pruner:
    """Prunes periodically; the `keep` newest blocks stay (0: archive).

    `followed` as in `highest_prunable`.
    """

    def __init__(self, ledger: LedgerStore, keep: int, followed: Callable[[], int | None]) -> None:
        self._ledger = ledger
        self._keep = keep
        self._followed = followed
        self._retention = Retention(ledger)
        self._held_by = HeldBy.NOTHING
        self._listeners: list[Callable[[int], None]] = []

    def add_listener(self, listener: Callable[[int], None]) -> None:
        """Call `listener` after pruning with the earliest height with a body."""
        self._listeners.append(listener)

    async def _prune(self, below: int) -> int:
        earliest = await prune_ledger(self._ledger, below)
        for listener in self._listeners:
            listener(earliest)
        return earliest

    async def prune_to(self, keep: int) -> None:
        """Prune now except `keep` and what the custodian must follow. Raises NODE_IS_ARCHIVE."""
        if not self._keep:
            raise BlockRobotError("NODE_IS_ARCHIVE")
        position = self._ledger.position
        head = 0 if position is None else position.height
        below = highest_prunable(head, max(keep, KEEP_BLOCKS_MIN_COUNT), self._followed())
        await self._prune(below)

    async def run_once(self) -> None:
        if not self._keep:
            return
        try:
            below, self._held_by = await self._retention.find_cutoff(self._keep, self._followed())
            if below < self._retention.earliest()[0] + PRUNE_SLACK_COUNT:
                return
            earliest = await self._prune(below)
        except BlockRobotError as error:
            log.warning("prune_failed", code=error.code, detail=error.detail)
            return
        except Exception:  # what a later version of a contract writes may not be readable: the rest goes on
            log.exception("prune_fault")
            return
        log.info("ledger_pruned", earliest_height=earliest)

    def describe(self) -> dict[str, Any]:
        try:
            earliest_ms: int | None = self._retention.earliest()[1]
        except BlockRobotError:
            earliest_ms = None
        return {
            "archive": not self._keep,
            "earliest_ms": earliest_ms,
            "held_by": self._held_by.value or None,
        }


def request_pruning(data_dir: Path, keep: int) -> Path:
    """Request pruning by the running node; return the file that it deletes when done."""
    path = data_dir / REQUEST_FILE_NAME
    temporary = path.with_suffix(".tmp")
    temporary.write_text(str(keep), encoding="ascii")
    temporary.replace(path)
    return path


async def answer_requests(data_dir: Path, pruner: Pruner) -> None:
    """Prune if a request file is in the data directory; drop invalid requests."""
    path = data_dir / REQUEST_FILE_NAME
    try:
        keep = int(path.read_text(encoding="ascii"))
        await pruner.prune_to(keep)
    except FileNotFoundError:
        return
    except (ValueError, OSError, BlockRobotError) as error:
        log.warning("prune_request_failed", detail=str(error))
    path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class PrunedLedger:
    """What a pruned ledger has; `held_back_by_custody`: the custodian's checkpoint limited it."""

    height: int
    earliest_height: int
    held_back_by_custody: bool


async def prune_stopped_node(config: NodeConfig, keep: int) -> PrunedLedger:
    """Prune a stopped node's ledger under the data directory's lock.

    Raises DATA_DIRECTORY_INVALID, STORAGE_*, STORE_UNAVAILABLE.
    """
    followed: int | None = None
    if config.custodian_key_path is not None:
        async with open_store(config.custody_store, config.custody_dir, clips=config.clips) as store:
            checkpoint = await store.checkpoint()
            followed = -1 if checkpoint is None else checkpoint.height
    ledger = LmdbStore.open(config.ledger_dir)
    try:
        head = 0 if ledger.position is None else ledger.position.height
        below = highest_prunable(head, keep, followed)
        earliest = await prune_ledger(ledger, below)
    finally:
        await ledger.close()
    wanted = highest_prunable(head, keep, None)
    return PrunedLedger(head, earliest, held_back_by_custody=earliest < wanted)
