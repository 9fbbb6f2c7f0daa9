"""Other processes of this machine, by their number."""

from __future__ import annotations

import os


def is_process_alive(pid: int) -> bool:
    """Tell whether some process has this number now; it need not be the one that had it before."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
