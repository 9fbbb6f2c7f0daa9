"""Lets a robot run once at a time: two at one spool would write over each other's clips.

An advisory lock on a file in the robot's folder: the kernel drops it when the process ends, however it ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from consensus.errors import BlockRobotError

LOCK_FILE = "robot.lock"


@contextlib.contextmanager
def only_run(folder: Path) -> Iterator[None]:
    """Hold the robot of a folder while inside. Raises ROBOT_RUNNING if another process does, ROBOT_NOT_FOUND."""
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
