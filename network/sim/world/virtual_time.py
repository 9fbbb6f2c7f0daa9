"""An event loop whose clock jumps from timer to timer.

Work belongs to an `Owner` (a node's life): a dead one's never runs, a paused one's waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import random
import traceback
from asyncio import events
from collections import deque
from collections.abc import Callable, Coroutine, Iterable
from contextvars import Context
from typing import Any, cast

EXECUTOR_DELAY_MS = (0.1, 2.0)
STEPS_A_LOOK_COUNT = 16


class PowerCutError(BaseException):
    """Ends what a node is doing at once; node code does not catch it."""


class Owner:
    """One life of an actor: alive, killed or paused; core busy until `free_at_s`."""

    __slots__ = ("alive", "backlog", "free_at_s", "name", "paused", "queue", "tasks")

    def __init__(self, name: str) -> None:
        self.name = name
        self.alive = True
        self.paused = False
        self.backlog: list[_Handle] = []
        self.free_at_s = 0.0
        self.queue: deque[_Handle] = deque()
        self.tasks: list[asyncio.Task[Any]] = []


class _Handle:
    """Something scheduled; also a timer."""

    __slots__ = ("args", "callback", "context", "dropped", "owner", "time")

    def __init__(
        self, owner: Owner, time: float, callback: Callable[..., Any], args: tuple[Any, ...], context: Context | None
    ) -> None:
        self.owner = owner
        self.time = time
        self.callback = callback
        self.args = args
        self.context = context
        self.dropped = False

    def cancel(self) -> None:
        self.dropped = True
        self.args = ()

    def cancelled(self) -> bool:
        return self.dropped

    def when(self) -> float:
        return self.time


class SimLoop:
    """Runs due work by time, then scheduling order; thread work runs inline."""

    def __init__(self, seed: int) -> None:
        self.stage = Owner("stage")
        self.owner = self.stage
        self.random = random.Random(seed)  # noqa: S311 - a simulation's dice
        self.faults: list[str] = []
        self.steps = 0
        self._now_s = 0.0
        self._sequence = 0
        self._ready: deque[_Handle] = deque()
        self._timers: list[tuple[float, int, _Handle]] = []

    # The clock and what is scheduled

    def time(self) -> float:
        """Virtual seconds since the start."""
        return self._now_s

    @property
    def now_ms(self) -> float:
        return self._now_s * 1000

    def call_soon(self, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> _Handle:
        handle = _Handle(self.owner, self._now_s, callback, args, context)
        self._ready.append(handle)
        return handle

    call_soon_threadsafe = call_soon

    def call_soon_for(self, owner: Owner, callback: Callable[..., Any], *args: Any) -> _Handle:
        handle = _Handle(owner, self._now_s, callback, args, None)
        self._ready.append(handle)
        return handle

    def call_at(self, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> _Handle:
        """Run a callback at a virtual time (s), as the present owner."""
        return self.call_for(self.owner, when, callback, *args, context=context)

    def call_later(
        self, delay: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> _Handle:
        return self.call_for(self.owner, self._now_s + delay, callback, *args, context=context)

    def call_for(
        self, owner: Owner, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> _Handle:
        """As `call_at`, for `owner`."""
        handle = _Handle(owner, when, callback, args, context)
        self._sequence += 1
        heapq.heappush(self._timers, (when, self._sequence, handle))
        return handle

    # Lives

    def kill(self, owner: Owner) -> None:
        owner.alive = False
        owner.backlog.clear()
        owner.queue.clear()

    def pause(self, owner: Owner) -> None:
        owner.paused = True

    def resume(self, owner: Owner) -> None:
        owner.paused = False
        self._ready.extend(owner.backlog)
        owner.backlog = []

    # Cores

    def occupy(self, work_s: float) -> None:
        """Keep the present owner's core busy for `work_s` more seconds."""
        owner = self.owner
        if owner is not self.stage:
            owner.free_at_s = max(owner.free_at_s, self._now_s) + work_s

    def _wait_for_core(self, handle: _Handle) -> None:
        queue = handle.owner.queue
        queue.append(handle)
        if len(queue) == 1:
            self.call_for(self.stage, handle.owner.free_at_s, self._serve, handle.owner)

    def _serve(self, owner: Owner) -> None:
        queue = owner.queue
        while queue and not owner.paused and owner.free_at_s <= self._now_s:
            self._execute(queue.popleft())
        if owner.paused:
            owner.backlog += queue
            queue.clear()
        elif queue:
            self.call_for(self.stage, owner.free_at_s, self._serve, owner)

    # Running

    @property
    def as_loop(self) -> asyncio.AbstractEventLoop:
        """Return this loop typed as asyncio's; only the parts in use exist."""
        return cast("asyncio.AbstractEventLoop", self)

    def run_until(self, is_over: Callable[[], bool], limit_s: float) -> bool:
        """Run until `is_over()`; False after `limit_s` of virtual time or when idle."""
        ready, timers = self._ready, self._timers
        events._set_running_loop(self.as_loop)
        try:
            while not is_over():
                for _ in range(STEPS_A_LOOK_COUNT):
                    if not ready:
                        while timers and timers[0][2].dropped:
                            heapq.heappop(timers)
                        if not timers or timers[0][0] > limit_s:
                            self._now_s = max(self._now_s, limit_s)
                            return is_over()
                        when, _, handle = heapq.heappop(timers)
                        self._now_s = max(self._now_s, when)
                        self._run(handle)
                    while ready:
                        self._run(ready.popleft())
            return True
        finally:
            events._set_running_loop(None)

    def _run(self, handle: _Handle) -> None:
        owner = handle.owner
        if handle.dropped or not owner.alive:
            return
        if owner.paused:
            owner.backlog.append(handle)
        elif owner.queue or owner.free_at_s > self._now_s:
            self._wait_for_core(handle)
        else:
            self._execute(handle)

    def _execute(self, handle: _Handle) -> None:
        if handle.dropped:
            return
        self.owner = handle.owner
        self.steps += 1
        try:
            if handle.context is None:
                handle.callback(*handle.args)
            else:
                handle.context.run(handle.callback, *handle.args)
        except PowerCutError:
            return
        except Exception as error:  # noqa: BLE001 - a fault of the code under test
            self._note_fault("In a callback", error)
        finally:
            self.owner = self.stage

    # What asyncio asks of a loop

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self.as_loop)

    def create_task(
        self, coro: Coroutine[Any, Any, Any], *, name: str | None = None, context: Context | None = None
    ) -> asyncio.Task[Any]:
        task = asyncio.Task(coro, loop=self.as_loop, name=name, context=context)
        tasks = self.owner.tasks
        if len(tasks) > 512:
            tasks[:] = [known for known in tasks if not known.done()]
        tasks.append(task)
        return task

    def run_in_executor(
        self,
        executor: Any,  # noqa: ARG002 - asyncio's signature
        func: Callable[..., Any],
        *args: Any,
    ) -> asyncio.Future[Any]:
        future = self.create_future()

        def work() -> None:
            if future.cancelled():
                return
            try:
                result = func(*args)
            except Exception as error:  # noqa: BLE001 - handed to the one who waits
                future.set_exception(error)
            else:
                future.set_result(result)

        self.call_later(self.random.uniform(*EXECUTOR_DELAY_MS) / 1000, work)
        return future

    def get_debug(self) -> bool:
        """Return False: asyncio's debug mode would read real clocks."""
        return False

    def is_running(self) -> bool:
        return True

    def is_closed(self) -> bool:
        return False

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if isinstance(error, Exception):
            self._note_fault(str(context.get("message")), error)

    def _note_fault(self, message: str, error: BaseException) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        place = f" at {frames[-1].name}, line {frames[-1].lineno} of {frames[-1].filename}" if frames else ""
        self.faults.append(f"{message}: {error!r}{place}")

    def end(self, owners: Iterable[Owner]) -> None:
        """End all lives; record unretrieved exceptions and cancel remaining work."""
        for owner in owners:
            alive = owner.alive
            self.kill(owner)
            for task in owner.tasks:
                if not task.done():
                    task._log_destroy_pending = False  # type: ignore[attr-defined]
                    with contextlib.suppress(RuntimeError):
                        task.get_coro().close()
                elif not task.cancelled() and task._log_traceback:
                    error = task.exception()
                    if alive and isinstance(error, Exception):
                        self._note_fault(f"In the task {task.get_name()}", error)
            owner.tasks.clear()
        self._ready.clear()
        self._timers.clear()
