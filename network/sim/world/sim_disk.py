"""The disk of one simulated node: what was synced stays, what was not may be lost or torn.

It keeps the promises of `journal_disk.Disk` and no more: bytes are safe after the file's `sync`, names after their
directory's. A power cut keeps of the rest what the dice say: a prefix of the unsynced bytes, the last of them perhaps
garbled, and either all unsynced names or none.
"""

from __future__ import annotations

import errno
import random
from collections.abc import Callable
from pathlib import Path

GARBLED_MAX_BYTES = 16


class _Content:
    """A file's bytes, and how many of them are on the medium."""

    __slots__ = ("data", "durable", "was_cut")

    def __init__(self, data: bytes = b"") -> None:
        self.data = bytearray(data)
        self.durable = bytearray(data)
        self.was_cut = False


class SimDisk:
    """See `journal_disk.Disk`. `before_sync` and `after_sync` are called around each sync of a file, to cut the power.

    `tears` says what the next power cut takes of unsynced bytes: `all`, a `part`, or as the `dice` say. `sync_ms` is
    how long a sync takes; `is_full` makes every write fail with ENOSPC.
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
        """Tell whether there is a file under this path."""
        return path in self._names

    def open(self, path: Path, *, create: bool) -> SimFile:
        """Open a file; with `create` a new, empty one."""
        if create:
            self.require_room()
            self._names[path] = _Content()
        elif path not in self._names:
            raise FileNotFoundError(path)
        return SimFile(self, self._names[path])

    def replace(self, source: Path, target: Path) -> None:
        """Let `target` name the file that `source` named; durable with the directory."""
        self._names[target] = self._names.pop(source)

    def remove(self, path: Path) -> None:
        """Remove a file; durable with the directory."""
        if path not in self._names:
            raise FileNotFoundError(path)
        del self._names[path]

    def sync_directory(self, directory: Path) -> None:
        """Make the names in a directory durable."""
        kept = {path: content for path, content in self._durable_names.items() if path.parent != directory}
        self._durable_names = kept | {
            path: content for path, content in self._names.items() if path.parent == directory
        }

    # What happens to disks

    def require_room(self) -> None:
        """Raise OSError if the disk is full."""
        if self.is_full:
            raise OSError(errno.ENOSPC, "No space left on device")

    def sync(self, content: _Content) -> None:
        """Bring a file's bytes to the medium, unless the power goes before."""
        self.before_sync()
        if content.was_cut:
            content.durable, content.was_cut = content.data.copy(), False
        else:
            content.durable += content.data[len(content.durable) :]
        self.busy_s += self.sync_ms / 1000
        self.syncs_count += 1
        self.after_sync()

    def cut_power(self) -> None:
        """Lose what was not synced, or a part of it, as the dice say."""
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
        """Return a copy of all files, as a backup takes it."""
        return {path: bytes(content.durable) for path, content in self._names.items()}

    def restore(self, image: dict[Path, bytes]) -> None:
        """Put a backup in the place of everything, durably. Only while the node is down."""
        self._names = {path: _Content(data) for path, data in image.items()}
        self._durable_names = dict(self._names)


class SimFile:
    """See `node.consensus.journal_disk.DiskFile`."""

    def __init__(self, disk: SimDisk, content: _Content) -> None:
        self._disk = disk
        self._content = content

    def read_all(self) -> bytes:
        """Return the whole content."""
        return bytes(self._content.data)

    def append(self, data: bytes) -> None:
        """Write at the end; a full disk takes a part of it at most."""
        if self._disk.is_full:
            self._content.data += data[: self._disk.dice.randint(0, max(0, len(data) - 1))]
        self._disk.require_room()
        self._content.data += data

    def truncate(self, size_bytes: int) -> None:
        """Cut the file."""
        del self._content.data[size_bytes:]
        self._content.was_cut = True

    def sync(self) -> None:
        """Make the content durable. Raises OSError on a full disk."""
        self._disk.require_room()
        self._disk.sync(self._content)

    def close(self) -> None:
        """Let go of the file."""


def _nothing() -> None:
    """Do nothing: no power cut is armed."""
