"""Work that lasts: for measurements that are ended in the middle of it."""

from __future__ import annotations

import os
import time
from pathlib import Path

from consensus.errors import BlockRobotError

WORK_MAX_S = 120.0


def work_long(folder: str, number: int) -> int:
    """Say by a file, named by the process, that the work began; then be at it for two minutes."""
    (Path(folder) / f"began-{os.getpid()}").touch()
    time.sleep(WORK_MAX_S)
    return number


def work_briefly(_number: int) -> int:
    """Return the process that did it."""
    time.sleep(0.5)
    return os.getpid()


def refuse(code: str, detail: str) -> None:
    raise BlockRobotError(code, detail)
