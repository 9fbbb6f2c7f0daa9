"""Prints where tests put their files: in memory where there is room, since stores and journals sync at every step.

Tests kill processes, never the machine, so nothing is lost by it. TMPDIR chooses another place. Needs no package.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

MEMORY = Path("/dev/shm")
ROOM_MIN_BYTES = 10 * 2**30
"""A whole long run leaves six."""
MEMINFO = Path("/proc/meminfo")


def find_temporary_folder(memory: Path = MEMORY, meminfo: Path = MEMINFO) -> Path:
    """Return the folder in memory if it and the machine have room for a whole run, else the usual one."""
    usual = Path(tempfile.gettempdir())
    if "TMPDIR" in os.environ:
        return usual
    try:
        free_kib = next(
            line.split()[1] for line in meminfo.read_text().splitlines() if line.startswith("MemAvailable:")
        )
        room = min(shutil.disk_usage(memory).free, int(free_kib) * 1024)
    except (OSError, StopIteration, ValueError):
        return usual
    return memory if room >= ROOM_MIN_BYTES and os.access(memory, os.W_OK) else usual


if __name__ == "__main__":
    sys.stdout.write(f"{find_temporary_folder()}\n")
