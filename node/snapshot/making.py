"""Makes a snapshot from one finalized ledger version, in one read transaction."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from consensus.chain.block import Block, EpochProof, FinalityProof, Header
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from node.snapshot.snapshot_format import (
    CHUNK_SIZE_BYTES,
    MANIFEST_NAME,
    Manifest,
    RecentChunk,
    RecentRow,
    SnapshotSink,
    StateChunk,
    chunk_name,
    write_manifest,
)
from node.storage.ledger_store import LedgerSnapshot, Position
from node.storage.synced_files import sync_directory

STATE_ROWS_MAX_COUNT = 1 << 60
ROW_OVERHEAD_BYTES = 16

Progress = Callable[[int, int], None]
"""Called now and then with how many chunks and bytes are done."""

T = TypeVar("T")


def no_progress(_chunks: int, _size_bytes: int) -> None: ...


def read_header_bytes(ledger: LedgerSnapshot, height: int) -> bytes | None:
    """Pruned or not; None if unknown."""
    block = ledger.block(height)
    return ledger.kept_header(height) if block is None else decode(block, Block).header_bytes


def header_of_block(block_bytes: bytes) -> bytes:
    """Return a pruned block's remainder: its header's canonical bytes."""
    return decode(block_bytes, Block).header_bytes


def _cut(rows: Iterator[T], size_of: Callable[[T], int]) -> Iterator[tuple[T, ...]]:
    group: list[T] = []
    size = 0
    empty = True
    for row in rows:
        row_size = size_of(row) + ROW_OVERHEAD_BYTES
        if group and size + row_size > CHUNK_SIZE_BYTES:
            yield tuple(group)
            group, size = [], 0
        group.append(row)
        size += row_size
        empty = False
    if group or empty:
        yield tuple(group)


def _recent_rows(ledger: LedgerSnapshot, position: Position) -> Iterator[RecentRow]:
    """Yield the last ten minutes' blocks and the one before, proving completeness."""
    window_ms = position.timestamp_ms - TRANSACTION_LIFETIME_MAX_MS
    first_ms = 0
    for block in ledger.iter_recent(0):
        if block.timestamp_ms > window_ms:
            break
        first_ms = block.timestamp_ms
    for block in ledger.iter_recent(first_ms):
        header = read_header_bytes(ledger, block.height)
        if header is None:
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger lacks the header of block {block.height}.")
        yield RecentRow(header, block.transactions)


def _recent_size(row: RecentRow) -> int:
    return len(row.header_bytes) + 48 * len(row.transactions)


def _state_size(row: tuple[bytes, bytes]) -> int:
    return len(row[0]) + len(row[1])


def _epoch_proofs(ledger: LedgerSnapshot) -> tuple[bytes, ...]:
    proofs: list[bytes] = []
    while (proof := ledger.epoch_proof(len(proofs) + 1)) is not None:
        proofs.append(proof)
    return tuple(proofs)


def make_snapshot(ledger: LedgerSnapshot, sink: SnapshotSink, progress: Progress = no_progress) -> Manifest:
    """Write the newest block's snapshot into `sink`; return its manifest. Raises STORAGE_DAMAGED."""
    position = ledger.position
    block = None if position is None else ledger.block(position.height)
    receipts = None if position is None else ledger.receipts(position.height)
    if position is None or block is None or receipts is None:
        raise BlockRobotError("STORAGE_DAMAGED", "The ledger does not hold its newest block.")
    digests: list[bytes] = []
    size = recent_count = state_count = 0

    def put(data: bytes) -> None:
        nonlocal size
        sink.put_chunk(len(digests), data)
        digests.append(sha256(data))
        size += len(data)
        progress(len(digests), size)

    for blocks in _cut(_recent_rows(ledger, position), _recent_size):
        put(encode(RecentChunk(blocks)))
        recent_count += len(blocks)
    recent_chunks = len(digests)
    for rows in _cut(ledger.scan(b"", STATE_ROWS_MAX_COUNT), _state_size):
        put(encode(StateChunk(rows)))
        state_count += len(rows)
    header = decode(block, Block).header
    manifest = Manifest(
        chain_id=header.chain_id,
        height=position.height,
        block=block,
        receipts=receipts,
        finality=ledger.finality,
        epoch_proofs=_epoch_proofs(ledger),
        recent_chunk_count=recent_chunks,
        recent_block_count=recent_count,
        state_row_count=state_count,
        size_bytes=size,
        chunks=tuple(digests),
    )
    sink.put_manifest(write_manifest(manifest))
    return manifest


class _NewFolder:
    def __init__(self, path: Path) -> None:
        self._path = path

    def put_chunk(self, index: int, data: bytes) -> None:
        self._write(chunk_name(index), data)

    def put_manifest(self, data: bytes) -> None:
        self._write(MANIFEST_NAME, data)

    def _write(self, name: str, data: bytes) -> None:
        with (self._path / name).open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())


def make_snapshot_folder(ledger: LedgerSnapshot, path: Path, progress: Progress = no_progress) -> Manifest:
    """Make a snapshot folder that appears once whole. Raises FOLDER_NOT_EMPTY, FILE_UNUSABLE."""
    if path.exists():
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"There is something at {path} already.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as own:
            unfinished = Path(own, path.name)
            unfinished.mkdir(mode=0o700)
            manifest = make_snapshot(ledger, _NewFolder(unfinished), progress)
            unfinished.rename(path)
        sync_directory(path.parent)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror}.") from error
    return manifest


def describe_manifest(manifest: Manifest) -> dict[str, object]:
    """Unproven claims, for JSON."""
    header = decode(manifest.block, Block).header
    proved = decode(manifest.finality, FinalityProof).header_bytes if manifest.finality else b""
    return {
        "chain_id": manifest.chain_id.hex(),
        "height": manifest.height,
        "epoch": header.epoch,
        "epochs_proved": [decode(proof, EpochProof).epoch.number for proof in manifest.epoch_proofs],
        "timestamp_ms": header.timestamp_ms,
        "block_id": decode(manifest.block, Block).block_id.hex(),
        "state_root": header.state_root.hex(),
        "names_its_proof": manifest.height == 0 or decode(proved, Header) == header,
        "state_rows": manifest.state_row_count,
        "recent_blocks": manifest.recent_block_count,
        "chunks": len(manifest.chunks),
        "size_bytes": manifest.size_bytes,
    }
