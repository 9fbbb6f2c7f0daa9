"""The few things that a journal does to a disk, as a Protocol. Must never report as synced what the disk may still lose.

`SystemDisk` is the real one; a simulator puts another in its place, to crash, to tear writes and to fill up.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Protocol

from consensus.errors import BlockRobotError

_SYNC_WHOLLY = getattr(fcntl, "F_FULLFSYNC", None)
"""macOS: fsync leaves data in the drive's cache, this does not."""


class DiskFile(Protocol):
    """One open file, owned by this process alone. Every method raises OSError if the disk refuses."""

    def read_all(self) -> bytes:
        """Return the whole content."""
        ...

    def append(self, data: bytes) -> None:
        """Write all of `data` at the end; it is safe only after `sync`."""
        ...

    def truncate(self, size_bytes: int) -> None:
        """Cut the file to this size; later appends go there."""
        ...

    def sync(self) -> None:
        """Return once all content and the file's size are on the medium."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


class Disk(Protocol):
    """The file system of one node."""

    def exists(self, path: Path) -> bool:
        """Tell whether there is a file under this path."""
        ...

    def open(self, path: Path, *, create: bool) -> DiskFile:
        """Open a file for this process alone; with `create` a new, empty one in place of any other.

        Raises FileNotFoundError if it is missing (without `create`), DATA_DIRECTORY_IN_USE if another holds it.
        """
        ...

    def replace(self, source: Path, target: Path) -> None:
        """Let `target` name the file that `source` named, atomically."""
        ...

    def remove(self, path: Path) -> None:
        """Remove a file. Raises FileNotFoundError if there is none."""
        ...

    def sync_directory(self, directory: Path) -> None:
        """Return once the directory's names are on the medium."""
        ...


class SystemFile:
    """A file of the operating system, locked with `flock`."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def read_all(self) -> bytes:
        """Return the whole content."""
        parts: list[bytes] = []
        offset = 0
        while part := os.pread(self._descriptor, 1 << 20, offset):
            parts.append(part)
            offset += len(part)
        return b"".join(parts)

    def append(self, data: bytes) -> None:
        """Write all of `data` at the end."""
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]

    def truncate(self, size_bytes: int) -> None:
        """Cut the file to this size."""
        os.ftruncate(self._descriptor, size_bytes)

    def sync(self) -> None:
        """Return once all content and the file's size are on the medium."""
        if _SYNC_WHOLLY is not None:
            fcntl.fcntl(self._descriptor, _SYNC_WHOLLY)
        else:
            os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Let go of the file and its lock."""
        os.close(self._descriptor)


class SystemDisk:
    """The file system of the machine."""

    def exists(self, path: Path) -> bool:
        """Tell whether there is a file under this path."""
        return path.is_file()

    def open(self, path: Path, *, create: bool) -> SystemFile:
        """Open a file (mode 0600) for this process alone; see `Disk.open` for the errors."""
        flags = os.O_RDWR | os.O_APPEND | os.O_CLOEXEC | (os.O_CREAT if create else 0)
        descriptor = os.open(path, flags, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(descriptor).st_ino != path.stat().st_ino:
                raise BlockingIOError("the file was replaced while it was opened")
        except BlockingIOError as error:
            os.close(descriptor)
            raise BlockRobotError("DATA_DIRECTORY_IN_USE", f"Another process already uses {path}.") from error
        except BaseException:
            os.close(descriptor)
            raise
        if create:
            os.ftruncate(descriptor, 0)
        return SystemFile(descriptor)

    def replace(self, source: Path, target: Path) -> None:
        """Let `target` name the file that `source` named, atomically."""
        source.replace(target)

    def remove(self, path: Path) -> None:
        """Remove a file."""
        path.unlink()

    def sync_directory(self, directory: Path) -> None:
        """Return once the directory's names are on the medium."""
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
