"""Bounds decompression of recording chunks, which the library leaves unlimited."""

from __future__ import annotations

import shutil
import sys
import tempfile
from bz2 import BZ2Decompressor
from collections.abc import Callable
from typing import IO, Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from consensus.errors import BlockRobotError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

CHUNK_MAX_BYTES = 256 * 1024 * 1024
"""Recorders end a chunk at some megabytes, or after its first message if that is larger."""
CHUNK_STREAMS_MAX_COUNT = 1_024
"""Recorders write one; what packs in parallel, one for each 900 KB."""
UNPACKED_FILE_MAX_BYTES = 32 * 1024**3
"""Of one file that is packed as a whole; recorders begin another one at some gigabytes."""
UNPACKING_LEAVES_BYTES = 1024**3
"""So much of the disk stays free, however many files there are."""


class ChunkTooLargeError(Exception):
    """A chunk is oversized, truncated, or has trailing data."""


def _bounded(make: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Return a bounded decompressor of one or several concatenated streams."""

    def decompress(data: bytes) -> bytes:
        found = bytearray()
        for _ in range(CHUNK_STREAMS_MAX_COUNT):
            decompressor = make()
            found += decompressor.decompress(data, max_length=CHUNK_MAX_BYTES + 1 - len(found))
            if len(found) > CHUNK_MAX_BYTES or not decompressor.eof:
                raise ChunkTooLargeError(f"A chunk is not whole, or has more than {CHUNK_MAX_BYTES >> 20} MiB.")
            data = decompressor.unused_data
            if not data:
                return bytes(found)
        raise ChunkTooLargeError(f"A chunk has more than {CHUNK_STREAMS_MAX_COUNT} streams.")

    return decompress


unpack_bz2, unpack_lz4, unpack_zstd = (
    _bounded(make) for make in (BZ2Decompressor, LZ4FrameDecompressor, zstd.ZstdDecompressor)
)


class _BoundedFile:
    def __init__(self, packed: IO[bytes], _mode: str) -> None:
        self._opened = zstd.open(packed, "rb")
        self._read_bytes = 0

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def read(self, size: int) -> bytes:
        """Read bytes. Raises RECORDING_TOO_LARGE at the limit."""
        found: bytes = self._opened.read(size)
        self._read_bytes += len(found)
        if self._read_bytes > UNPACKED_FILE_MAX_BYTES:
            detail = f"A file of it has more than {UNPACKED_FILE_MAX_BYTES >> 20} MiB once it is unpacked."
            raise BlockRobotError("RECORDING_TOO_LARGE", detail)
        place = tempfile.gettempdir()
        if shutil.disk_usage(place).free - len(found) < UNPACKING_LEAVES_BYTES:
            detail = f"Unpacking it would leave less than {UNPACKING_LEAVES_BYTES >> 20} MiB free in {place}."
            raise BlockRobotError("RECORDING_TOO_LARGE", detail)
        return found


class _BoundedZstd:
    open = _BoundedFile
    decompress = staticmethod(unpack_zstd)


def bound_chunks() -> None:
    """Install the bounded functions in the library."""
    rosbag1.decompressors.update({"bz2": unpack_bz2, "lz4": unpack_lz4})
    storage_mcap.DECOMPRESSORS.update(
        {"lz4": lambda data, _: unpack_lz4(data), "zstd": lambda data, _: unpack_zstd(data)}
    )
    rosbag2.zstd = _BoundedZstd  # type: ignore[assignment, attr-defined]
