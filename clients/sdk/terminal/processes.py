"""Other processes of this machine, by PID."""

from __future__ import annotations

import os


def is_process_alive(pid: int) -> bool:
    """Return whether a PID is in use; PIDs may be reused."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
