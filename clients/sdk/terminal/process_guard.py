"""Keep a command's secrets out of core files. Nodes have the same in `node.process_memory`: clients may not import it."""

from __future__ import annotations

import ctypes
import sys

_PR_SET_DUMPABLE = 4


def guard_process() -> bool:
    """Let this process leave no core file and be read by no other process of its user. Linux; tell whether it is so."""
    if sys.platform != "linux":
        return False
    import resource  # noqa: PLC0415 - not there on every system

    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    return bool(ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0) == 0)
