"""One worker process as the node holds it: started, asked, watched, ended. Must never give it anything but its pipe.

The watch is for what hangs, never for what takes long: a worker that gets no processor time for long, or takes more of
it than any block could need, is given up. What was asked is then asked of another one.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import time
from collections.abc import Callable, Sequence

import msgspec

from contracts.state.view import StateReader, StateView
from contracts.worker.wire import (
    FROM_WORKER,
    Begin,
    Broken,
    Doing,
    Executed,
    ExecutedRun,
    FromNode,
    FromWorker,
    Get,
    Hello,
    Page,
    Pipe,
    Refused,
    Rows,
    Scan,
    Value,
    Viewed,
)

LOOK_INTERVAL_MS = 500
STALLED_MAX_MS = 15_000
PROCESSOR_MAX_MS = 120_000
SCAN_ROWS_MAX_COUNT = 100_000
_CLOSED_WAIT_S = 5.0

Answer = Hello | Executed | ExecutedRun | Viewed | Refused | Broken


class WorkerLostError(Exception):
    """The worker died, hung or spoke nonsense; `place` is the transaction that it had in hand, if it said so."""

    def __init__(self, reason: str, place: int | None = None) -> None:
        self.reason = reason
        self.place = place
        super().__init__(reason)


class WorkerHandle:
    """A running worker. One thread at a time."""

    def __init__(self, command: Sequence[str], begin: Begin, *, stalled_max_ms: int = STALLED_MAX_MS) -> None:
        """Start the process and tell it the beginning. Raises WorkerLostError if the system starts no process."""
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={},
                cwd="/",
                bufsize=0,
                start_new_session=True,
            )
        except OSError as error:
            raise WorkerLostError(f"no process could be started: {error}") from error
        if self._process.stdin is None or self._process.stdout is None:
            raise AssertionError("the process was started with pipes")
        self._to, self._from = self._process.stdin, self._process.stdout
        os.set_blocking(self._to.fileno(), False)
        self._stalled_max_ms = stalled_max_ms
        self._reading, self._writing = select.poll(), select.poll()
        self._reading.register(self._from.fileno(), select.POLLIN)
        self._writing.register(self._to.fileno(), select.POLLOUT)
        self._pipe = Pipe(
            self._from.fileno(), self._to.fileno(), lambda: self._wait(self._reading), lambda: self._wait(self._writing)
        )
        self._asked_cpu_ms = self._cpu_ms = 0.0
        self._moved_ms = 0.0
        self._place: int | None = None
        self._hello: Hello | None = None
        self.answers_count = 0
        """How many questions it has answered: a worker that has answered none is as good as new."""
        self._send(begin)

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def hello(self) -> Hello:
        """Wait until the worker is behind its wall; return what it says of that. Raises WorkerLostError."""
        if self._hello is None:
            answer = self._receive(None)
            if not isinstance(answer, Hello):
                raise WorkerLostError("it did not begin with its wall")
            self._hello = answer
        return self._hello

    def ask(
        self, message: FromNode, state: StateReader | StateView
    ) -> Executed | ExecutedRun | Viewed | Refused | Broken:
        """Send one message and return the answer to it; rows that it asks back for are read from `state`.

        Raises WorkerLostError, and whatever reading `state` raises.
        """
        self.hello()
        self._place = None
        self._send(message)
        answer = self._receive(state)
        if isinstance(answer, Hello):
            raise WorkerLostError("it began a second time", self._place)
        self.answers_count += 1
        return answer

    def end(self) -> None:
        """Kill the process, if it still runs, and let go of it; one that the kernel holds on to is reaped later."""
        self._process.kill()
        self._to.close()
        self._from.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_CLOSED_WAIT_S)

    # Speaking

    def _send(self, message: FromNode) -> None:
        self._asked_cpu_ms = self._cpu_ms = self._processor_ms()
        self._moved_ms = time.monotonic() * 1000
        try:
            self._pipe.send(message)
        except OSError as error:
            raise WorkerLostError(self._how_it_ended(error)) from error

    def _receive(self, state: StateReader | StateView | None) -> Answer:
        try:
            while True:
                message: FromWorker = self._pipe.receive(FROM_WORKER)
                self._moved_ms = time.monotonic() * 1000
                if isinstance(message, Doing):
                    self._place = message.place
                elif isinstance(message, Get | Page | Scan):
                    self._pipe.send(_read(message, state))
                else:
                    return message
        except (EOFError, OSError, msgspec.MsgspecError) as error:
            raise WorkerLostError(self._how_it_ended(error), self._place) from error

    def _how_it_ended(self, error: Exception) -> str:
        if isinstance(error, msgspec.MsgspecError):
            return f"it spoke nonsense: {error}"
        try:
            code = self._process.wait(_CLOSED_WAIT_S)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        return f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"

    # Watching

    def _wait(self, poll: select.poll) -> None:
        """Wait until the pipe is ready. Raises WorkerLostError once the worker is given up."""
        while not poll.poll(LOOK_INTERVAL_MS):
            now_ms, cpu_ms = time.monotonic() * 1000, self._processor_ms()
            if cpu_ms != self._cpu_ms:
                self._cpu_ms, self._moved_ms = cpu_ms, now_ms
            if now_ms - self._moved_ms > self._stalled_max_ms:
                raise WorkerLostError("it hangs", self._place)
            if cpu_ms - self._asked_cpu_ms > PROCESSOR_MAX_MS:
                raise WorkerLostError("it does not come to an end", self._place)

    def _processor_ms(self) -> float:
        """Return the process's processor time; where the system does not tell, the time that passes."""
        try:
            return time.clock_gettime(~self.pid << 3 | 2) * 1000  # the kernel's number of another process's clock
        except OSError:
            return time.monotonic() * 1000


def _read(question: Get | Page | Scan, state: StateReader | StateView | None) -> Value | Rows:
    if state is None:
        raise WorkerLostError("it asks for rows before it was asked for anything")
    if isinstance(question, Get):
        return Value(state.get(question.key))
    if isinstance(question, Scan):
        return Rows(list(state.scan(question.prefix, min(question.limit, SCAN_ROWS_MAX_COUNT))))
    page: Callable[[bytes], bytes | None] | None = getattr(state, "page", None)
    return Value(None if page is None else page(question.path))
