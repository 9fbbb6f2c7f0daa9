"""Ends a run by signal: first orderly, second at once, keeping the spool."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def stopped_by_signals(stop: asyncio.Event, tell: Callable[[], None]) -> Iterator[None]:
    """First SIGINT or SIGTERM sets `stop` and calls `tell`; the next cancels."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task(loop)
    assert task is not None

    def heard() -> None:
        if stop.is_set():
            task.cancel()
        else:
            stop.set()
            tell()

    for number in SIGNALS:
        loop.add_signal_handler(number, heard)
    try:
        yield
    finally:
        for number in SIGNALS:
            loop.remove_signal_handler(number)
