"""Snapshot format: a manifest and numbered chunks, deterministic per block."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from consensus.chain.block import EpochProof
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hash

FORMAT_LINE = b"blockrobot-snapshot/1\n"
MANIFEST_NAME = "manifest"
CHUNK_SIZE_BYTES = 1024 * 1024
CHUNK_SIZE_MAX_BYTES = 6 * 1024 * 1024
MANIFEST_SIZE_MAX_BYTES = 6 * 1024 * 1024
CHUNKS_MAX_COUNT = 150_000
CHUNK_SIZE_MEAN_MIN_BYTES = CHUNK_SIZE_BYTES // 8
"""Any two chunks in a row are cut where they would be too large for one, by an estimate up to four times their size."""
CHUNKS_SHORT_MAX_COUNT = 2
"""The last chunk of the replay window, and that of the state."""
COUNTS_END = 1 << 63
_FORMAT_NAME_START = b"blockrobot-snapshot/"
_CONTENT_TAG = "blockrobot/snapshot"


class Manifest(Wire, frozen=True):
    """A snapshot's contents as canonical bytes."""

    chain_id: bytes
    height: int
    block: bytes
    receipts: bytes
    finality: bytes
    epoch_proofs: tuple[bytes, ...]
    recent_chunk_count: int
    recent_block_count: int
    state_row_count: int
    size_bytes: int
    chunks: tuple[bytes, ...]


class RecentRow(Wire, frozen=True):
    """A replay-window block: header bytes, and (txid, valid_until_ms) in block order."""

    header_bytes: bytes
    transactions: tuple[tuple[bytes, int], ...]


class RecentChunk(Wire, frozen=True):
    """Consecutive blocks of the replay window, oldest first."""

    blocks: tuple[RecentRow, ...]


class StateChunk(Wire, frozen=True):
    """Consecutive state rows, flat key and encoded value, by key."""

    rows: tuple[tuple[bytes, bytes], ...]


def compute_content_id(manifest: Manifest) -> bytes:
    """Return a content's 32-byte hash, independent of proofs' certificates. Raises ENCODING_*."""
    proofs = [decode(data, EpochProof) for data in manifest.epoch_proofs]
    epochs = [part for proof in proofs for part in (proof.finality.header_bytes, encode(proof.epoch))]
    counts = [
        manifest.height,
        manifest.recent_chunk_count,
        manifest.recent_block_count,
        manifest.state_row_count,
        manifest.size_bytes,
        len(epochs),
    ]
    numbers = b"".join(number.to_bytes(8, "big") for number in counts)
    parts = [manifest.chain_id, manifest.block, manifest.receipts, *epochs]
    return tagged_hash(_CONTENT_TAG, numbers, *(sha256(part) for part in parts), *manifest.chunks)


def write_manifest(manifest: Manifest) -> bytes:
    content = FORMAT_LINE + encode(manifest)
    return content + sha256(content)


def read_manifest(data: bytes) -> Manifest:
    """Raises SNAPSHOT_VERSION for another format, SNAPSHOT_DAMAGED for a wrong hash or content."""
    if not data.startswith(FORMAT_LINE):
        line = data[:64].split(b"\n", 1)[0]
        if not line.startswith(_FORMAT_NAME_START):
            raise BlockRobotError("SNAPSHOT_DAMAGED", "The manifest is not that of a snapshot.")
        name = line.decode("ascii", "replace")
        expected = FORMAT_LINE.decode().strip()
        raise BlockRobotError("SNAPSHOT_VERSION", f"The snapshot has the format {name}; this version reads {expected}.")
    content, digest = data[:-HASH_SIZE_BYTES], data[-HASH_SIZE_BYTES:]
    if len(data) > MANIFEST_SIZE_MAX_BYTES or sha256(content) != digest:
        raise BlockRobotError("SNAPSHOT_DAMAGED", "The manifest does not have its hash.")
    try:
        manifest = decode(content[len(FORMAT_LINE) :], Manifest)
    except BlockRobotError as error:
        raise BlockRobotError("SNAPSHOT_DAMAGED", f"The manifest cannot be read: {error.detail}") from error
    counts = (manifest.height, manifest.recent_block_count, manifest.state_row_count, manifest.size_bytes)
    if (
        min(counts) < 0
        or max(counts) >= COUNTS_END
        or manifest.size_bytes > len(manifest.chunks) * CHUNK_SIZE_MAX_BYTES
        or manifest.size_bytes < (len(manifest.chunks) - CHUNKS_SHORT_MAX_COUNT) * CHUNK_SIZE_MEAN_MIN_BYTES
        or not 0 < manifest.recent_chunk_count <= len(manifest.chunks) <= CHUNKS_MAX_COUNT
        or any(len(digest) != HASH_SIZE_BYTES for digest in manifest.chunks)
        or not manifest.chain_id
    ):
        raise BlockRobotError("SNAPSHOT_DAMAGED", "The manifest contradicts itself.")
    return manifest


class SnapshotSource(Protocol):
    """Where a snapshot's parts come from; untrusted."""

    def manifest(self) -> bytes:
        """Raises SNAPSHOT_TRUNCATED."""
        ...

    def chunk(self, index: int) -> bytes:
        """Raises SNAPSHOT_TRUNCATED if it is missing."""
        ...


class SnapshotSink(Protocol):
    """Where a snapshot's parts go; the manifest comes last."""

    def put_chunk(self, index: int, data: bytes) -> None: ...

    def put_manifest(self, data: bytes) -> None: ...


def chunk_name(index: int) -> str:
    return f"chunk-{index:06d}"


class MemorySnapshotFolder:
    """A snapshot in memory: for tests and the simulator."""

    def __init__(self) -> None:
        self.chunks: dict[int, bytes] = {}
        self.manifest_bytes: bytes | None = None

    def put_chunk(self, index: int, data: bytes) -> None:
        self.chunks[index] = data

    def put_manifest(self, data: bytes) -> None:
        self.manifest_bytes = data

    def manifest(self) -> bytes:
        """Raises SNAPSHOT_TRUNCATED."""
        if self.manifest_bytes is None:
            raise BlockRobotError("SNAPSHOT_TRUNCATED", "The snapshot has no manifest.")
        return self.manifest_bytes

    def chunk(self, index: int) -> bytes:
        """Raises SNAPSHOT_TRUNCATED."""
        if index not in self.chunks:
            raise BlockRobotError("SNAPSHOT_TRUNCATED", f"The snapshot lacks its chunk {index}.")
        return self.chunks[index]


class SnapshotFolder:
    """A snapshot in a folder of the file system."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def manifest(self) -> bytes:
        """Raises FILE_UNUSABLE and SNAPSHOT_TRUNCATED."""
        return self._read(MANIFEST_NAME, MANIFEST_SIZE_MAX_BYTES)

    def chunk(self, index: int) -> bytes:
        """Raises FILE_UNUSABLE and SNAPSHOT_TRUNCATED."""
        return self._read(chunk_name(index), CHUNK_SIZE_MAX_BYTES)

    def _read(self, name: str, size_max_bytes: int) -> bytes:
        try:
            with (self.path / name).open("rb") as file:
                data = file.read(size_max_bytes + 1)
        except (FileNotFoundError, NotADirectoryError):
            raise BlockRobotError("SNAPSHOT_TRUNCATED", f"There is no file {name} in {self.path}.") from None
        except OSError as error:
            raise BlockRobotError("FILE_UNUSABLE", f"{self.path / name}: {error.strerror}.") from error
        if len(data) > size_max_bytes:
            raise BlockRobotError("SNAPSHOT_DAMAGED", f"The file {name} is larger than any of its kind.")
        return data
