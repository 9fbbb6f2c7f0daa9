"""Keep secrets in a process's own memory, and no longer than they are needed.

What this cannot promise: Python copies values at will and returns freed memory as it is. So a secret is wiped right after
its use, by whoever was given it, and nothing is known of copies that libraries make. Nothing is locked against swapping:
the secrets wiped here live for microseconds.
"""

from __future__ import annotations

import ctypes
import sys

WIPED_MIN_BYTES = 16
"""Shorter values may be shared by the interpreter."""
_PR_SET_DUMPABLE = 4
_DATA_AT = bytes.__basicsize__ - 1


def guard_process() -> bool:
    """Let this process leave no core file and be read by no other process of its user. Linux; tell whether it is so."""
    if sys.platform != "linux":
        return False
    import resource  # noqa: PLC0415 - not there on every system

    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    return bool(ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0) == 0)


def wipe(secret: bytes | bytearray) -> None:
    """Overwrite a secret in place; only for one that was made for the caller alone, and is not used again.

    `bytes` are wiped where they lie in CPython; elsewhere, and if they are short, they stay.
    """
    if isinstance(secret, bytearray):
        secret[:] = bytes(len(secret))
    elif len(secret) >= WIPED_MIN_BYTES and sys.implementation.name == "cpython":
        ctypes.memset(id(secret) + _DATA_AT, 0, len(secret))
