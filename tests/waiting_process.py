"""Waits until a process at a terminal waits for a key itself, so that one Ctrl-C must do. It never presses twice.

Python hears of a signal between two steps or from a call that it breaks off. One that comes in the moment before the
reading begins is heard with the next key, here as anywhere: so it is the reading that is waited for.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

WAITING_MAX_S = 60.0


def wait_for_reading(pid: int) -> None:
    """Return once a process whose question has been seen waits for its answer; of a shell, the command that it runs.

    Raises AssertionError if it does not within 60 s.
    """
    deadline = time.monotonic() + WAITING_MAX_S
    while not _is_waiting(_innermost(pid)):
        assert time.monotonic() < deadline, f"process {pid} does not wait for a key"
        os.sched_yield()


def _innermost(pid: int) -> int:
    while children := Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split():
        pid = int(children[-1])
    return pid


def _is_waiting(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "S"
