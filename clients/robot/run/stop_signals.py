"""Ends a run when its user says so: once in good order, twice at once.

In good order means that the source ends there: what is in memory is decided, sealed and recorded, and every visit closed.
At once means that what is sealed stays in the spool, for the next run to record.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def stopped_by_signals(stop: asyncio.Event, tell: Callable[[], None]) -> Iterator[None]:
    """While inside, set `stop` and call `tell` at the first SIGINT or SIGTERM; cancel the current task at the next."""
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
