"""Lets one program at a time have a wallet open: of two, the later to write would lose what the other had noted.

An advisory lock on a file beside the wallet's: the kernel drops it when the process ends, however it ends. Must never
keep anybody waiting for long, nor leave a lock behind.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from consensus.errors import BlockRobotError

WAIT_MAX_S = 5.0
"""A command that runs at the same time is over soon; a page stays."""
_PAUSE_S = 0.05


@contextlib.contextmanager
def claim_wallet(
    path: Path, *, wait_s: float = WAIT_MAX_S, sleep: Callable[[float], None] = time.sleep
) -> Iterator[None]:
    """Hold a wallet's file while inside. Raises WALLET_BUSY if another program has it, WALLET_NOT_FOUND."""
    if not path.exists():
        raise BlockRobotError("WALLET_NOT_FOUND", f"There is no wallet at {path}.")
    descriptor = os.open(path.with_name(f".{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        for _ in range(max(1, round(wait_s / _PAUSE_S))):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                sleep(_PAUSE_S)
        else:
            raise BlockRobotError("WALLET_BUSY", f"Another program has {path} open.")
        yield
    finally:
        os.close(descriptor)
