"""Bounds decompression of recording chunks, which the library leaves unlimited."""

from __future__ import annotations

import shutil
import struct
import sys
import tempfile
from bz2 import BZ2Decompressor
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from clients.robot.sources.recordings.budget import current_budget
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

_RECORD_START = struct.Struct("<BQ")


class ChunkTooLargeError(Exception):
    """A chunk is oversized, truncated, or has trailing data."""


def _bounded(make: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Return a bounded decompressor of one or several concatenated streams."""

    def decompress(data: bytes) -> bytes:
        budget, found = current_budget(), []
        max_bytes = left = min(CHUNK_MAX_BYTES, budget.chunk_max_bytes, budget.unpacked_left)
        for _ in range(CHUNK_STREAMS_MAX_COUNT):
            decompressor = make()
            found.append(decompressor.decompress(data, max_length=left + 1))
            left -= len(found[-1])
            budget.count_unpacked(len(found[-1]))
            if left < 0 or not decompressor.eof:
                raise ChunkTooLargeError(f"A chunk is not whole, or has more than {max_bytes >> 20} MiB.")
            data = decompressor.unused_data
            if not data:
                return b"".join(found)
        raise ChunkTooLargeError(f"A chunk has more than {CHUNK_STREAMS_MAX_COUNT} streams.")

    return decompress


unpack_bz2, unpack_lz4, unpack_zstd = (
    _bounded(make) for make in (BZ2Decompressor, LZ4FrameDecompressor, zstd.ZstdDecompressor)
)


def _unpack_plain(data: bytes) -> bytes:
    """Copied from the file each time that it is asked for."""
    current_budget().count_unpacked(len(data))
    return data


def _counted(unpack: Callable[[bytes], bytes]) -> Callable[[bytes, int], bytes]:
    """Count the records of a chunk of MCAP before anything is made of them."""

    def decompress(data: bytes, _size: int) -> bytes:
        chunk, budget = unpack(data), current_budget()
        place = count = 0
        while place + _RECORD_START.size <= len(chunk) and count <= budget.records_left:
            place += _RECORD_START.size + _RECORD_START.unpack_from(chunk, place)[1]
            count += 1
        budget.count_records(count)
        return chunk

    return decompress


class _BoundedFile:
    def __init__(self, packed: IO[bytes], _mode: str) -> None:
        current_budget().open_once(Path(packed.name))
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
        current_budget().count_in_files(len(found))
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
    rosbag1.decompressors.update({"none": _unpack_plain, "bz2": unpack_bz2, "lz4": unpack_lz4})
    storage_mcap.DECOMPRESSORS.update(
        {"": _counted(_unpack_plain), "lz4": _counted(unpack_lz4), "zstd": _counted(unpack_zstd)}
    )
    rosbag2.zstd = _BoundedZstd  # type: ignore[assignment, attr-defined]
