"""A simulated node's disk, on which unsynced data may be lost or torn.

A power cut keeps a random prefix of unsynced bytes, and all unsynced names or none.
"""

from __future__ import annotations

import errno
import random
from collections.abc import Callable
from pathlib import Path

GARBLED_MAX_BYTES = 16


class _Content:
    """A file's bytes, and how many are durable."""

    __slots__ = ("data", "durable", "was_cut")

    def __init__(self, data: bytes = b"") -> None:
        self.data = bytearray(data)
        self.durable = bytearray(data)
        self.was_cut = False


class SimDisk:
    """See `journal_disk.Disk`; `tears`: unsynced bytes a power cut takes.

    `sync_ms`: a sync's duration; `is_full`: writes fail with ENOSPC.
    """

    def __init__(self, dice: random.Random) -> None:
        self.dice = dice
        self.is_full = False
        self.sync_ms = 0.05
        self.busy_s = 0.0
        self.syncs_count = 0
        self.tears = "dice"
        self.before_sync: Callable[[], None] = _nothing
        self.after_sync: Callable[[], None] = _nothing
        self._names: dict[Path, _Content] = {}
        self._durable_names: dict[Path, _Content] = {}

    # node.consensus.journal_disk.Disk

    def exists(self, path: Path) -> bool:
        return path in self._names

    def open(self, path: Path, *, create: bool) -> SimFile:
        if create:
            self.require_room()
            self._names[path] = _Content()
        elif path not in self._names:
            raise FileNotFoundError(path)
        return SimFile(self, self._names[path])

    def replace(self, source: Path, target: Path) -> None:
        """Durable with its directory."""
        self._names[target] = self._names.pop(source)

    def remove(self, path: Path) -> None:
        """Durable with its directory."""
        if path not in self._names:
            raise FileNotFoundError(path)
        del self._names[path]

    def sync_directory(self, directory: Path) -> None:
        kept = {path: content for path, content in self._durable_names.items() if path.parent != directory}
        self._durable_names = kept | {
            path: content for path, content in self._names.items() if path.parent == directory
        }

    # What happens to disks

    def require_room(self) -> None:
        if self.is_full:
            raise OSError(errno.ENOSPC, "No space left on device")

    def sync(self, content: _Content) -> None:
        self.before_sync()
        if content.was_cut:
            content.durable, content.was_cut = content.data.copy(), False
        else:
            content.durable += content.data[len(content.durable) :]
        self.busy_s += self.sync_ms / 1000
        self.syncs_count += 1
        self.after_sync()

    def cut_power(self) -> None:
        names = self._durable_names if self.dice.random() < 0.5 else self._names
        for content in names.values():
            unsynced = b"" if content.was_cut else bytes(content.data[len(content.durable) :])
            kept = bytearray(unsynced[: self._kept_bytes(len(unsynced))])
            if kept and self.dice.random() < 0.5:
                for _ in range(min(len(kept), GARBLED_MAX_BYTES)):
                    kept[-1 - self.dice.randrange(min(len(kept), GARBLED_MAX_BYTES))] = self.dice.randrange(256)
            content.durable += kept
            content.data, content.was_cut = content.durable.copy(), False
        self._names = dict(names)
        self._durable_names = dict(names)
        self.tears = "dice"

    def _kept_bytes(self, size: int) -> int:
        if self.tears == "all":
            return 0
        return self.dice.randint(min(1, size), size) if self.tears == "part" else self.dice.randint(0, size)

    def image(self) -> dict[Path, bytes]:
        return {path: bytes(content.durable) for path, content in self._names.items()}

    def restore(self, image: dict[Path, bytes]) -> None:
        self._names = {path: _Content(data) for path, data in image.items()}
        self._durable_names = dict(self._names)


class SimFile:
    """See `node.consensus.journal_disk.DiskFile`."""

    def __init__(self, disk: SimDisk, content: _Content) -> None:
        self._disk = disk
        self._content = content

    def read_all(self) -> bytes:
        return bytes(self._content.data)

    def append(self, data: bytes) -> None:
        if self._disk.is_full:
            self._content.data += data[: self._disk.dice.randint(0, max(0, len(data) - 1))]
        self._disk.require_room()
        self._content.data += data

    def truncate(self, size_bytes: int) -> None:
        del self._content.data[size_bytes:]
        self._content.was_cut = True

    def sync(self) -> None:
        self._disk.require_room()
        self._disk.sync(self._content)

    def close(self) -> None:
        """Let go of the file."""


def _nothing() -> None:
    """Do nothing: no power cut is armed."""
