"""The lock by which one process owns a directory: a `flock`, never stale."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from consensus.errors import BlockRobotError

LOCK_FILE_NAME = "owner.lock"


class DirectoryLock:
    """Held from construction until `release`."""

    def __init__(self, directory: Path) -> None:
        """Raises DATA_DIRECTORY_IN_USE if another holds the lock, DATA_DIRECTORY_INVALID if it cannot be taken."""
        try:
            descriptor = os.open(directory / LOCK_FILE_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise BlockRobotError(
                "DATA_DIRECTORY_INVALID", f"The directory {directory} cannot be written to: {error.strerror}."
            ) from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise BlockRobotError(
                "DATA_DIRECTORY_IN_USE", f"Another process already uses the directory {directory}."
            ) from error
        self._descriptor: int | None = descriptor

    def release(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
