"""Parent side of the single process that executes test chains."""

from __future__ import annotations

import atexit
import itertools
import threading
import weakref
from collections.abc import Sequence
from typing import TypeVar

from consensus.errors import BlockRobotError
from contracts.kit.engine import Call, Figures, Ran
from contracts.kit.tracing import Trace
from contracts.kit.worker import (
    ANSWERS,
    Answer,
    Deploy,
    EnterSandbox,
    Forget,
    MakeTrace,
    ReadFigures,
    ReadState,
    Request,
    Run,
    Withdraw,
)
from contracts.vm.model.faults import ContractSourceError
from contracts.worker.handle import SandboxedProcess
from contracts.worker.wire import SandboxFeature

_T = TypeVar("_T")
WORKER_MODULE = "contracts.kit.worker"


class _Worker:
    """The process and its lock: one request at a time."""

    def __init__(self) -> None:
        self._process = SandboxedProcess(WORKER_MODULE)
        self._lock = threading.Lock()
        self._forgotten: list[int] = []
        self._numbers = itertools.count(1)
        atexit.register(self._process.close)
        self.parts = self.ask(EnterSandbox()).parts

    @property
    def pid(self) -> int:
        return self._process.pid

    def next_chain(self) -> int:
        return next(self._numbers)

    def forget(self, chain: int) -> None:
        """Drop a chain at the next request; the garbage collector may call this during one."""
        self._forgotten.append(chain)

    def ask(self, request: Request) -> Answer:
        """Raises CONTRACT_WORKER_FAILED; the next chain starts a new process."""
        with self._lock:
            try:
                while self._forgotten:
                    self._process.ask(Forget(self._forgotten.pop()), ANSWERS)
                return self._process.ask(request, ANSWERS)
            except BaseException:
                _lose(self)
                atexit.unregister(self._process.close)
                self._process.close()
                raise


_workers: list[_Worker] = []


def _worker() -> _Worker:
    if not _workers:
        _workers.append(_Worker())
    return _workers[0]


def _lose(worker: _Worker) -> None:
    if worker in _workers:
        _workers.remove(worker)


class SandboxedEngine:
    """An `Engine` in the sandboxed process: same methods, results and errors."""

    def __init__(self) -> None:
        """Raises CONTRACT_WORKER_FAILED."""
        self._worker = _worker()
        self._chain = self._worker.next_chain()
        weakref.finalize(self, self._worker.forget, self._chain)

    @property
    def parts(self) -> Sequence[SandboxFeature]:
        return self._worker.parts

    @property
    def pid(self) -> int:
        return self._worker.pid

    def deploy(self, source: str, name: str) -> str:
        answer = self._ask(Deploy(self._chain, source, name))
        if answer.problems:
            raise ContractSourceError(name, tuple(answer.problems))
        return answer.migrates_by

    def withdraw(self, name: str) -> None:
        self._ask(Withdraw(self._chain, name))

    def run(self, call: Call, *, keep: bool) -> Ran:
        return _there(self._ask(Run(self._chain, call, keep)).ran)

    def trace(self, call: Call, who: str) -> Trace:
        return _there(self._ask(MakeTrace(self._chain, call, who)).trace)

    def read_state(self, contract: str) -> tuple[list[tuple[bytes, bytes]], bytes]:
        answer = self._ask(ReadState(self._chain, contract))
        return answer.rows, answer.state_root

    def figures(self) -> list[Figures]:
        return self._ask(ReadFigures(self._chain)).figures

    def _ask(self, request: Request) -> Answer:
        answer = self._worker.ask(request)
        if answer.refused is not None:
            raise BlockRobotError(*answer.refused)
        return answer


def _there(part: _T | None) -> _T:
    if part is None:
        raise BlockRobotError("CONTRACT_WORKER_FAILED", "The process that executes contracts gave another answer.")
    return part
