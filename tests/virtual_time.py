"""An event loop whose clock jumps: a wait of an hour takes no time. Must never be used with real sockets or processes."""

from __future__ import annotations

import asyncio
import functools
import selectors
from collections.abc import Callable, Coroutine
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
THREAD_MAX_S = 5.0
"""How long the clock stands still, at most, for a thread that works."""


class _JumpingSelector(selectors.DefaultSelector):  # type: ignore[misc,valid-type]
    """Where a loop would sleep, its clock moves on instead; while a thread works, it stands still."""

    now_s = 1_000.0
    working: set[asyncio.Future[Any]]

    def select(self, timeout: float | None = None) -> Any:
        real = None if timeout is None else THREAD_MAX_S if timeout and self.working else 0
        ready = super().select(real)
        if not ready and timeout:
            self.now_s += timeout
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop on a clock of its own."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        self._jumping.working = set()
        super().__init__(self._jumping)

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> asyncio.Future[Any]:
        future = super().run_in_executor(executor, func, *args)
        self._jumping.working.add(future)
        future.add_done_callback(self._jumping.working.discard)
        return future

    def time(self) -> float:
        return self._jumping.now_s

    def now_ms(self) -> int:
        """Milliseconds on the loop's clock, as a wall clock would say them."""
        return 1_800_000_000_000 + round(self._jumping.now_s * 1000)


def run_virtual(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end in virtual time."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)


def in_virtual_time(main: Callable[P, Coroutine[Any, Any, T]]) -> Callable[P, T]:
    """Make a function, as of a test, that runs the coroutine's to its end in virtual time."""

    @functools.wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        return run_virtual(main(*args, **kwargs))

    return run


def virtual_now_ms() -> int:
    """The wall clock inside of `run_virtual`."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    return loop.now_ms()
