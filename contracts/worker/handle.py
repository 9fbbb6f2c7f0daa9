"""The node's handle of one worker process, which gets only its pipe.

A worker that gets no processor time for long, or uses more than any block needs, is given up.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any, TypeVar

import msgspec

from consensus.errors import BlockRobotError
from contracts.state.view import StateReader, StateView
from contracts.worker.wire import (
    FROM_WORKER,
    Begin,
    Broken,
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
    newest_place,
)

LOOK_INTERVAL_MS = 500
STALLED_MAX_MS = 15_000
PROCESSOR_MAX_MS = 10_000
"""The dearest block takes some 2 s of a slow machine: compiling as much as its gas buys."""
NOTES_MAX_BYTES = 64 * 1024
ENDLESS = "it does not come to an end"
SCAN_ROWS_MAX_COUNT = 256
_CLOSED_WAIT_S = 5.0

Answer = Hello | Executed | ExecutedRun | Viewed | Refused | Broken


class WorkerLostError(Exception):
    """The worker died, hung or broke protocol; `place` is its last note (transaction or IN_CHANGE)."""

    def __init__(self, reason: str, place: int | None = None) -> None:
        self.reason = reason
        self.place = place
        super().__init__(reason)


class WorkerHandle:
    """A running worker; one thread at a time."""

    def __init__(
        self,
        command: Sequence[str],
        begin: Begin,
        *,
        stalled_max_ms: int = STALLED_MAX_MS,
        processor_max_ms: int | None = PROCESSOR_MAX_MS,
    ) -> None:
        """Start the process. `processor_max_ms` limits each request, None does not. Raises WorkerLostError."""
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env={},
                cwd="/",
                bufsize=0,
                start_new_session=True,
            )
        except OSError as error:
            raise WorkerLostError(f"no process could be started: {error}") from error
        if self._process.stdin is None or self._process.stdout is None or self._process.stderr is None:
            raise AssertionError("the process was started with pipes")
        self._to, self._from, self._notes = self._process.stdin, self._process.stdout, self._process.stderr
        os.set_blocking(self._to.fileno(), False)
        os.set_blocking(self._notes.fileno(), False)
        self._stalled_max_ms = stalled_max_ms
        self._processor_max_ms = processor_max_ms
        self._reading, self._writing = select.poll(), select.poll()
        self._reading.register(self._from.fileno(), select.POLLIN)
        self._writing.register(self._to.fileno(), select.POLLOUT)
        self._pipe = Pipe(
            self._from.fileno(), self._to.fileno(), lambda: self._wait(self._reading), lambda: self._wait(self._writing)
        )
        self._asked_cpu_ms = self._cpu_ms = 0.0
        self._moved_ms = 0.0
        self._hello: Hello | None = None
        self.answers_count = 0
        """How many questions it has answered: a worker that has answered none is as good as new."""
        self._send(begin)

    @property
    def pid(self) -> int:
        return self._process.pid

    def hello(self) -> Hello:
        """Wait until the worker is sandboxed. Raises WorkerLostError."""
        if self._hello is None:
            answer = self._receive(None)
            if not isinstance(answer, Hello):
                raise WorkerLostError("it did not begin in its sandbox")
            self._hello = answer
        return self._hello

    def ask(
        self, message: FromNode, state: StateReader | StateView
    ) -> Executed | ExecutedRun | Viewed | Refused | Broken:
        """Send a message, serving row requests from `state`. Raises WorkerLostError and read errors."""
        self.hello()
        self._read_notes()
        self._send(message)
        answer = self._receive(state)
        if isinstance(answer, Hello):
            raise WorkerLostError("it began a second time")
        self.answers_count += 1
        return answer

    def newest_place(self) -> int | None:
        return newest_place(self._read_notes())

    def _read_notes(self) -> bytes:
        with contextlib.suppress(OSError):
            return os.read(self._notes.fileno(), NOTES_MAX_BYTES)
        return b""

    def end(self) -> None:
        """Kill and release the process; an unkillable one is reaped later."""
        self._process.kill()
        for pipe in (self._to, self._from, self._notes):
            pipe.close()
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
                if isinstance(message, Get | Page | Scan):
                    self._pipe.send(_read(message, state))
                else:
                    return message
        except (EOFError, OSError, msgspec.MsgspecError) as error:
            how = self._how_it_ended(error)
            raise WorkerLostError(how, self.newest_place()) from error

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
        while not poll.poll(LOOK_INTERVAL_MS):
            now_ms, cpu_ms = time.monotonic() * 1000, self._processor_ms()
            if cpu_ms != self._cpu_ms:
                self._cpu_ms, self._moved_ms = cpu_ms, now_ms
            if now_ms - self._moved_ms > self._stalled_max_ms:
                raise WorkerLostError("it hangs", self.newest_place())
            limit_ms = None if self._hello is None else self._processor_max_ms
            if limit_ms is not None and cpu_ms - self._asked_cpu_ms > limit_ms:
                raise WorkerLostError(ENDLESS, self.newest_place())

    def _processor_ms(self) -> float:
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
        limit = min(max(question.limit, 0), SCAN_ROWS_MAX_COUNT)
        return Rows(list(islice(state.scan_range(question.start, question.end), limit)))
    page: Callable[[bytes], bytes | None] | None = getattr(state, "page", None)
    return Value(None if page is None else page(question.path))


_M = TypeVar("_M")


class SandboxedProcess:
    """A tool's helper: `python -I -m MODULE` in the root folder, empty environment, no terminal, no keys."""

    def __init__(self, module: str) -> None:
        """Raises CONTRACT_WORKER_FAILED."""
        try:
            self._process = subprocess.Popen(
                (sys.executable, "-I", "-m", module), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, env={}, cwd="/", bufsize=0, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise BlockRobotError("CONTRACT_WORKER_FAILED", f"No process could be started: {error}.") from error
        if self._process.stdin is None or self._process.stdout is None:
            raise AssertionError("the process was started with pipes")
        self._pipe = Pipe(self._process.stdout.fileno(), self._process.stdin.fileno())

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, message: Any, answers: msgspec.msgpack.Decoder[_M]) -> _M:
        """Raises CONTRACT_WORKER_FAILED."""
        try:
            self._pipe.send(message)
            return self._pipe.receive(answers)
        except (EOFError, OSError, msgspec.MsgspecError) as error:
            detail = f"The process that executes contracts ended: {type(error).__name__}."
            raise BlockRobotError("CONTRACT_WORKER_FAILED", detail) from error

    def close(self) -> None:
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait()
