"""Runs a measurement that starts nodes, and stops them however it ends.

SIGTERM and SIGHUP cancel it once, like Ctrl-C.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
_EXIT_BY_SIGNAL = 128

T = TypeVar("T")


def run_to_end(work: Coroutine[Any, Any, T]) -> T:
    """Run a measurement; exits with 128 plus signal number if one ended it."""
    heard: list[signal.Signals] = []

    async def cancellable() -> T:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None

        def end(number: signal.Signals) -> None:
            if not heard:
                task.cancel()
            heard.append(number)

        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as under `nohup`
                loop.add_signal_handler(number, end, number)
        return await work

    try:
        return asyncio.run(cancellable())
    except asyncio.CancelledError:
        if not heard:
            raise
        sys.exit(_EXIT_BY_SIGNAL + heard[0])
