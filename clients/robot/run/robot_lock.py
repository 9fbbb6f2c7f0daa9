"""Lets one run use a robot's folder, by an advisory file lock."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from consensus.errors import BlockRobotError

LOCK_FILE = "robot.lock"


@contextlib.contextmanager
def lock_robot(folder: Path) -> Iterator[None]:
    """Hold a robot's lock. Raises ROBOT_RUNNING, ROBOT_NOT_FOUND."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except FileNotFoundError:
        raise BlockRobotError("ROBOT_NOT_FOUND", f"There is no robot in {folder}.") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockRobotError("ROBOT_RUNNING", f"The robot in {folder} runs already.") from None
        yield
    finally:
        os.close(descriptor)
