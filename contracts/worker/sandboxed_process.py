"""A sandboxed helper process for tools, without keys or environment."""

from __future__ import annotations

import subprocess
import sys
from typing import Any, TypeVar

import msgspec

from consensus.errors import BlockRobotError
from contracts.worker.wire import Pipe

_M = TypeVar("_M")


class SandboxedProcess:
    """Runs `python -I -m MODULE` in the root folder, empty environment, no terminal."""

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
        """Send a message, return the answer. Raises CONTRACT_WORKER_FAILED."""
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
