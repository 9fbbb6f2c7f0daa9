"""Disk operations of the journal, as a Protocol simulators can replace.

Nothing is reported as synced that the disk may still lose.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Protocol

from consensus.errors import BlockRobotError
from node.storage.synced_files import sync_directory

_SYNC_WHOLLY = getattr(fcntl, "F_FULLFSYNC", None)
"""macOS: fsync leaves data in the drive's cache, this does not."""


class DiskFile(Protocol):
    """One exclusively opened file; methods raise OSError if the disk refuses."""

    def read_all(self) -> bytes: ...

    def append(self, data: bytes) -> None:
        """Append all of `data`; durable only after `sync`."""
        ...

    def truncate(self, size_bytes: int) -> None: ...

    def sync(self) -> None:
        """Return once content and size are durable."""
        ...

    def close(self) -> None: ...


class Disk(Protocol):
    """The file system of one node."""

    def exists(self, path: Path) -> bool: ...

    def open(self, path: Path, *, create: bool) -> DiskFile:
        """Open a file exclusively; `create` makes a new, empty one.

        Raises FileNotFoundError (without `create`), DATA_DIRECTORY_IN_USE.
        """
        ...

    def replace(self, source: Path, target: Path) -> None: ...

    def remove(self, path: Path) -> None:
        """Remove a file. Raises FileNotFoundError."""
        ...

    def sync_directory(self, directory: Path) -> None:
        """Return once the directory's names are durable."""
        ...


class SystemFile:
    """A file of the operating system, locked with `flock`."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def read_all(self) -> bytes:
        parts: list[bytes] = []
        offset = 0
        while part := os.pread(self._descriptor, 1 << 20, offset):
            parts.append(part)
            offset += len(part)
        return b"".join(parts)

    def append(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]

    def truncate(self, size_bytes: int) -> None:
        os.ftruncate(self._descriptor, size_bytes)

    def sync(self) -> None:
        if _SYNC_WHOLLY is not None:
            fcntl.fcntl(self._descriptor, _SYNC_WHOLLY)
        else:
            os.fdatasync(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


class SystemDisk:
    """The file system of the machine."""

    def exists(self, path: Path) -> bool:
        return path.is_file()

    def open(self, path: Path, *, create: bool) -> SystemFile:
        """With mode 0600; see `Disk.open`."""
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
        source.replace(target)

    def remove(self, path: Path) -> None:
        path.unlink()

    def sync_directory(self, directory: Path) -> None:
        sync_directory(directory)
