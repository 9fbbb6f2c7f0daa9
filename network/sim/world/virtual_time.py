"""An event loop whose clock jumps from one timer to the next.

Everything that is scheduled belongs to an `Owner`, one life of one node (or the stage itself): what a dead owner had
scheduled never runs, which is how a power cut ends a process. A paused owner's work waits until it goes on.
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
    """Ends what a node was doing at this very moment; no handler of the node's code may catch it."""


class Owner:
    """One life of one actor: alive until it is killed, perhaps paused for a while, its core busy until `free_at_s`."""

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
    """The loop: `run_until(condition)` carries out what is due, in the order of time and then of scheduling.

    `owner` is whose code is running; `random` delays what production code does in threads, which is done inline.
    """

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
        """Return the virtual time in seconds since the start."""
        return self._now_s

    @property
    def now_ms(self) -> float:
        """The virtual time in milliseconds since the start."""
        return self._now_s * 1000

    def call_soon(self, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> _Handle:
        """Run a callback next, in the name of the present owner."""
        handle = _Handle(self.owner, self._now_s, callback, args, context)
        self._ready.append(handle)
        return handle

    call_soon_threadsafe = call_soon

    def call_soon_for(self, owner: Owner, callback: Callable[..., Any], *args: Any) -> _Handle:
        """Run a callback next, in the name of `owner`."""
        handle = _Handle(owner, self._now_s, callback, args, None)
        self._ready.append(handle)
        return handle

    def call_at(self, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> _Handle:
        """Run a callback at a virtual time (s), in the name of the present owner."""
        return self.call_for(self.owner, when, callback, *args, context=context)

    def call_later(
        self, delay: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> _Handle:
        """Run a callback after a virtual delay (s), in the name of the present owner."""
        return self.call_for(self.owner, self._now_s + delay, callback, *args, context=context)

    def call_for(
        self, owner: Owner, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> _Handle:
        """Run a callback at a virtual time (s) in the name of `owner`."""
        handle = _Handle(owner, when, callback, args, context)
        self._sequence += 1
        heapq.heappush(self._timers, (when, self._sequence, handle))
        return handle

    # Lives

    def kill(self, owner: Owner) -> None:
        """End a life: nothing of it runs any more."""
        owner.alive = False
        owner.backlog.clear()
        owner.queue.clear()

    def pause(self, owner: Owner) -> None:
        """Let nothing of an owner run until `resume`."""
        owner.paused = True

    def resume(self, owner: Owner) -> None:
        """Let a paused owner do all that became due meanwhile."""
        owner.paused = False
        self._ready.extend(owner.backlog)
        owner.backlog = []

    # Cores

    def occupy(self, work_s: float) -> None:
        """Let the present owner's core be busy for so long, after what it is busy with already."""
        owner = self.owner
        if owner is not self.stage:
            owner.free_at_s = max(owner.free_at_s, self._now_s) + work_s

    def _wait_for_core(self, handle: _Handle) -> None:
        queue = handle.owner.queue
        queue.append(handle)
        if len(queue) == 1:
            self.call_for(self.stage, handle.owner.free_at_s, self._serve, handle.owner)

    def _serve(self, owner: Owner) -> None:
        """The core is free: do what waited for it, in order, until it is busy again."""
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
        """This loop under the name of what it stands in for: it has as much of it as the code under test uses."""
        return cast("asyncio.AbstractEventLoop", self)

    def run_until(self, is_over: Callable[[], bool], limit_s: float) -> bool:
        """Carry out what is due until `is_over()`; False if the virtual time passed `limit_s` or nothing is left.

        It looks at the beginning, every few steps and at the end: a look may cost more than a step.
        """
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
        """Return a future of this loop."""
        return asyncio.Future(loop=self.as_loop)

    def create_task(
        self, coro: Coroutine[Any, Any, Any], *, name: str | None = None, context: Context | None = None
    ) -> asyncio.Task[Any]:
        """Start a task that belongs to the present owner."""
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
        """Do what would be done in a thread inline, a little later."""
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
        """Return True."""
        return True

    def is_closed(self) -> bool:
        """Return False."""
        return False

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Note an exception that nobody caught: a fault of the code under test."""
        error = context.get("exception")
        if isinstance(error, Exception):
            self._note_fault(str(context.get("message")), error)

    def _note_fault(self, message: str, error: BaseException) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        place = f" at {frames[-1].name}, line {frames[-1].lineno} of {frames[-1].filename}" if frames else ""
        self.faults.append(f"{message}: {error!r}{place}")

    def end(self, owners: Iterable[Owner]) -> None:
        """End all lives: note exceptions that nobody looked at, and let go of what would still run."""
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
