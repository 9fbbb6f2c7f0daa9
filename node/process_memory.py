"""Protects secrets in process memory (copies by Python and swapping remain possible)."""

from __future__ import annotations

import ctypes
import sys

WIPED_MIN_BYTES = 16
"""Shorter values may be shared by the interpreter."""
_PR_SET_DUMPABLE = 4
_DATA_AT = bytes.__basicsize__ - 1


def guard_process() -> bool:
    """Disable core files and reading by other processes; Linux; return success."""
    if sys.platform != "linux":
        return False
    import resource  # noqa: PLC0415 - not there on every system

    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    return bool(ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0) == 0)


def wipe(secret: bytes | bytearray) -> None:
    """Overwrite a secret owned by the caller; `bytes` only if long, in CPython."""
    if isinstance(secret, bytearray):
        secret[:] = bytes(len(secret))
    elif len(secret) >= WIPED_MIN_BYTES and sys.implementation.name == "cpython":
        ctypes.memset(id(secret) + _DATA_AT, 0, len(secret))
