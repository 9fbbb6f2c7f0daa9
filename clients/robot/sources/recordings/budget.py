"""What a recording may take of its reader, in proportion to its size on disk.

Recordings of constant frames were measured: chunks of zstd and bz2 unpack to 5,600 times a file's size, SQLite packed as
a whole to 1,000 times. Limits per byte leave them ten times that.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

from consensus.errors import BlockRobotError

UNPACKED_LEAST_BYTES = 64 * 1024 * 1024
UNPACKED_PER_BYTE = 64 * 1024
"""In all, and what is unpacked or given out again counts again."""
HELD_LEAST_BYTES = 128 * 1024 * 1024
HELD_PER_BYTE = 4
"""At once: chunks whose times overlap. Recorders end a chunk at 1 to 5 MB, and two or three overlap."""
RECORD_HELD_BYTES = 256
"""What a record takes in addition to its data while its chunk is held."""
RECORDS_LEAST_COUNT = 100_000
RECORDS_PER_BYTE = 1
"""A message takes 12 bytes of an index (ROS 1) or 16 (MCAP), and more for itself."""
FILES_LEAST_BYTES = 128 * 1024 * 1024
FILES_PER_BYTE = 10 * 1024
"""Of files that are packed as a whole: they are unpacked to TMPDIR, which may be memory."""

_Item = TypeVar("_Item")


class RecordingBudget:
    """What one pass over a recording may take. Raises RECORDING_TOO_LARGE, BAG_DAMAGED for a file named twice."""

    def __init__(self, size_bytes: int) -> None:
        self._size_bytes = size_bytes
        self.unpacked_left = UNPACKED_LEAST_BYTES + UNPACKED_PER_BYTE * size_bytes
        self.chunk_max_bytes = self._held_left = HELD_LEAST_BYTES + HELD_PER_BYTE * size_bytes
        self._files_left = FILES_LEAST_BYTES + FILES_PER_BYTE * size_bytes
        self._opened: set[tuple[int, int]] = set()
        self.records_left = RECORDS_LEAST_COUNT + RECORDS_PER_BYTE * size_bytes

    def count_unpacked(self, size_bytes: int) -> None:
        self.unpacked_left -= size_bytes
        self._require(self.unpacked_left >= 0, "unpacks to more")

    def count_in_files(self, size_bytes: int) -> None:
        self._files_left -= size_bytes
        self._require(self._files_left >= 0, "unpacks to more")

    def count_records(self, count: int) -> None:
        self.records_left -= count
        self._require(self.records_left >= 0, "has more messages")

    @contextmanager
    def holding(self, size_bytes: int) -> Iterator[None]:
        try:
            self._hold(size_bytes)
            yield
        finally:
            self._hold(-size_bytes)

    def _hold(self, size_bytes: int) -> None:
        self._held_left -= size_bytes
        self._require(self._held_left >= 0 or size_bytes < 0, "has more at the same time")

    def open_once(self, path: Path) -> None:
        found = path.stat()
        if (found.st_dev, found.st_ino) in self._opened:
            raise BlockRobotError("BAG_DAMAGED", f"{path.name} is named twice in one recording.")
        self._opened.add((found.st_dev, found.st_ino))

    @property
    def is_spent(self) -> bool:
        return self.unpacked_left < 0 or self.records_left < 0

    def again(self) -> RecordingBudget:
        """This one, for one more pass with what is left."""
        self._opened.clear()
        return self

    def over(self, items: Generator[_Item, None, None]) -> Iterator[_Item]:
        """Yield the items, each made with this as the current budget."""
        with closing(items):
            while True:
                with self.current():
                    item = next(items, None)
                if item is None:
                    return
                yield item

    @contextmanager
    def current(self) -> Iterator[None]:
        token = _CURRENT.set(self)
        try:
            yield
        finally:
            _CURRENT.reset(token)

    def _require(self, is_within: bool, what: str) -> None:
        if not is_within:
            raise BlockRobotError("RECORDING_TOO_LARGE", f"It {what} than a file of {self._size_bytes} bytes does.")


_CURRENT: ContextVar[RecordingBudget | None] = ContextVar("recording_budget", default=None)


def current_budget() -> RecordingBudget:
    """The one of the pass that is under way; else a new one, of a file without bytes."""
    return _CURRENT.get() or RecordingBudget(0)


def budget_for(path: Path) -> RecordingBudget:
    """Raises OSError."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    found = {(one.st_dev, one.st_ino): one.st_size for one in (file.stat() for file in files)}
    return RecordingBudget(sum(found.values()))
