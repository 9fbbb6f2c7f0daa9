"""Snapshots that a node serves, made at milestones, after pruning, or on request (rate-limited)."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import structlog

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from node.p2p.wire import SnapshotRequest
from node.snapshot.making import make_snapshot_folder
from node.snapshot.snapshot_format import Manifest, SnapshotFolder, compute_content_id, read_manifest
from node.storage.ledger_store import LedgerSnapshot, LedgerStore

SNAPSHOTS_KEPT_COUNT = 2
MANIFEST_INDEX = -1
REQUESTED_INTERVAL_MIN_MS = 60_000
"""From the end of a snapshot that a peer asked for to the beginning of the next such one."""
REQUESTED_REST_COUNT = 10
"""That interval is at least this many times as long as the last snapshot took."""

log = structlog.get_logger(__name__)


def _monotonic_ms() -> int:
    return time.monotonic_ns() // 1_000_000


class SnapshotStore:
    """The newest snapshots of a ledger, each in a folder named by its height."""

    def __init__(self, ledger: LedgerStore, folder: Path, now_ms: Callable[[], int] = _monotonic_ms) -> None:
        """`now_ms` is monotonic."""
        self._now_ms = now_ms
        self._requests_from_ms = 0
        self._ledger = ledger
        self._folder = folder
        self._known: dict[int, tuple[bytes, Manifest]] = {}
        self._making: asyncio.Task[None] | None = None

    async def open(self) -> None:
        await asyncio.get_running_loop().run_in_executor(None, self._look)

    def _look(self) -> None:
        if not self._folder.is_dir():
            return
        for place in sorted(self._folder.iterdir()):
            try:
                manifest = read_manifest(SnapshotFolder(place).manifest())
                self._known[manifest.height] = (compute_content_id(manifest), manifest)
            except BlockRobotError:
                shutil.rmtree(place, ignore_errors=True)

    async def stop(self) -> None:
        if self._making is not None:
            await asyncio.gather(self._making, return_exceptions=True)

    def begin(self, snapshot: LedgerSnapshot) -> None:
        """Make a snapshot in a thread, one at a time; takes over `snapshot`."""
        self._begin(snapshot, is_requested=False)

    def note_pruned(self, earliest_height: int) -> None:
        if max(self._known, default=-1) + 1 < earliest_height:
            self.begin(self._ledger.snapshot())

    def _begin(self, snapshot: LedgerSnapshot, *, is_requested: bool) -> None:
        if self._making is not None and not self._making.done():
            snapshot.close()
            return
        making = self._make(snapshot, is_requested=is_requested)
        self._making = asyncio.get_running_loop().create_task(making, name="snapshot")

    async def _make(self, snapshot: LedgerSnapshot, *, is_requested: bool) -> None:
        begun_ms = self._now_ms()
        try:
            made = await asyncio.get_running_loop().run_in_executor(None, self._write, snapshot)
        except (BlockRobotError, OSError) as error:
            log.warning("snapshot_failed", detail=str(error))
            return
        finally:
            snapshot.close()
            if is_requested:
                ended_ms = self._now_ms()
                rest_ms = max(REQUESTED_INTERVAL_MIN_MS, REQUESTED_REST_COUNT * (ended_ms - begun_ms))
                self._requests_from_ms = ended_ms + rest_ms
        if made is not None:
            self._known[made.height] = (compute_content_id(made), made)
            log.info("snapshot_made", height=made.height, size_bytes=made.size_bytes)
        with self._ledger.snapshot() as now:
            useless = [height for height in self._known if height + 1 < now.earliest_height]
        for height in sorted({*useless, *sorted(self._known)[:-SNAPSHOTS_KEPT_COUNT]}):
            del self._known[height]
            await asyncio.get_running_loop().run_in_executor(None, shutil.rmtree, self._place(height), True)

    def _write(self, snapshot: LedgerSnapshot) -> Manifest | None:
        height = 0 if snapshot.position is None else snapshot.position.height
        if height in self._known:
            return None
        self._folder.mkdir(parents=True, mode=0o700, exist_ok=True)
        return make_snapshot_folder(snapshot, self._place(height))

    def _place(self, height: int) -> Path:
        return self._folder / f"{height:012d}"

    async def serve(self, body: bytes) -> bytes:
        """Return a manifest, a chunk, or nothing (yet). Raises ENCODING_*."""
        request = decode(body, SnapshotRequest)
        if request.index == MANIFEST_INDEX:
            return await self._offer(request.above_height)
        for height, (content_id, manifest) in self._known.items():
            if content_id == request.content_id and 0 <= request.index < len(manifest.chunks):
                return await self._read(height, request.index)
        return b""

    async def _offer(self, above_height: int) -> bytes:
        newest = max(self._known, default=-1)
        with self._ledger.snapshot() as snapshot:
            position, earliest = snapshot.position, snapshot.earliest_height
        if newest > above_height and newest + 1 >= earliest:
            return await self._read(newest, MANIFEST_INDEX)
        if position is not None and position.height > max(above_height, newest) and self._may_make():
            self._begin(self._ledger.snapshot(), is_requested=True)
        return b""

    def _may_make(self) -> bool:
        return self._requests_from_ms == 0 or self._now_ms() >= self._requests_from_ms

    async def _read(self, height: int, index: int) -> bytes:
        source = SnapshotFolder(self._place(height))

        def read() -> bytes:
            return source.manifest() if index == MANIFEST_INDEX else source.chunk(index)

        return await asyncio.get_running_loop().run_in_executor(None, read)
