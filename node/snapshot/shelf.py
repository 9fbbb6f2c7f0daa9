"""The snapshots that a node keeps for others, and hands out chunk by chunk. Must never hold the event loop up for a disk.

A node that prunes makes one at every milestone (a height that all nodes of the same setting share, so that a newcomer
can fetch its chunks from several of them); any node makes one when it is asked and has none that helps.
"""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import structlog

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from node.p2p.wire import SnapshotRequest
from node.snapshot.form import Manifest, SnapshotFolder, compute_content_id, read_manifest
from node.snapshot.making import UNFINISHED_SUFFIX, make_snapshot_folder
from node.storage.ledger_store import LedgerSnapshot, LedgerStore

SNAPSHOTS_KEPT_COUNT = 2
MANIFEST_INDEX = -1

log = structlog.get_logger(__name__)


class SnapshotShelf:
    """The newest snapshots of a ledger, each in a folder named by its height."""

    def __init__(self, ledger: LedgerStore, folder: Path) -> None:
        self._ledger = ledger
        self._folder = folder
        self._known: dict[int, tuple[bytes, Manifest]] = {}
        self._making: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Look at what is on the disk; what is not whole is thrown away."""
        await asyncio.get_running_loop().run_in_executor(None, self._look)

    def _look(self) -> None:
        if not self._folder.is_dir():
            return
        for place in sorted(self._folder.iterdir()):
            try:
                manifest = read_manifest(SnapshotFolder(place).manifest())
            except BlockRobotError:
                shutil.rmtree(place, ignore_errors=True)
                continue
            self._known[manifest.height] = (compute_content_id(manifest), manifest)

    async def stop(self) -> None:
        """Wait for a snapshot that is being made."""
        if self._making is not None:
            await asyncio.gather(self._making, return_exceptions=True)

    def begin(self, snapshot: LedgerSnapshot) -> None:
        """Make a snapshot of this version of the ledger in a thread; one at a time. Takes the version over."""
        if self._making is not None and not self._making.done():
            snapshot.close()
            return
        self._making = asyncio.get_running_loop().create_task(self._make(snapshot), name="snapshot")

    async def _make(self, snapshot: LedgerSnapshot) -> None:
        try:
            made = await asyncio.get_running_loop().run_in_executor(None, self._write, snapshot)
        except BlockRobotError as error:
            log.warning("snapshot_failed", code=error.code, detail=error.detail)
            return
        finally:
            snapshot.close()
        if made is not None:
            self._known[made.height] = (compute_content_id(made), made)
            log.info("snapshot_made", height=made.height, size_bytes=made.size_bytes)
        for height in sorted(self._known)[:-SNAPSHOTS_KEPT_COUNT]:
            del self._known[height]
            await asyncio.get_running_loop().run_in_executor(None, shutil.rmtree, self._place(height), True)

    def _write(self, snapshot: LedgerSnapshot) -> Manifest | None:
        height = 0 if snapshot.position is None else snapshot.position.height
        if height in self._known:
            return None
        self._folder.mkdir(parents=True, mode=0o700, exist_ok=True)
        shutil.rmtree(self._folder / (self._place(height).name + UNFINISHED_SUFFIX), ignore_errors=True)
        return make_snapshot_folder(snapshot, self._place(height))

    def _place(self, height: int) -> Path:
        return self._folder / f"{height:012d}"

    async def serve(self, body: bytes) -> bytes:
        """Answer a peer: a manifest's bytes, a chunk's, or nothing (yet). Raises ENCODING_*."""
        request = decode(body, SnapshotRequest)
        if request.index == MANIFEST_INDEX:
            return await self._offer(request.above_height)
        for height, (content_id, manifest) in self._known.items():
            if content_id == request.content_id and 0 <= request.index < len(manifest.chunks):
                return await self._read(height, request.index)
        return b""

    async def _offer(self, above_height: int) -> bytes:
        """Return the newest manifest that helps; begin to make one if there is none."""
        newest = max(self._known, default=-1)
        with self._ledger.snapshot() as snapshot:
            position, earliest = snapshot.position, snapshot.earliest_height
        if newest > above_height and newest + 1 >= earliest:
            return await self._read(newest, MANIFEST_INDEX)
        if position is not None and position.height > max(above_height, newest):
            self.begin(self._ledger.snapshot())
        return b""

    async def _read(self, height: int, index: int) -> bytes:
        source = SnapshotFolder(self._place(height))

        def read() -> bytes:
            return source.manifest() if index == MANIFEST_INDEX else source.chunk(index)

        return await asyncio.get_running_loop().run_in_executor(None, read)
