"""Guards this process's secrets, and finds others of this machine by PID."""

from __future__ import annotations

import ctypes
import os
import sys

_PR_SET_DUMPABLE = 4


def is_process_alive(pid: int) -> bool:
    """The PID may be another process's by now."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def guard_process() -> bool:
    """Forbid core files and same-user memory reads (Linux); return success."""
    if sys.platform != "linux":
        return False
    import resource  # noqa: PLC0415 - not there on every system

    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    return bool(ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0) == 0)
