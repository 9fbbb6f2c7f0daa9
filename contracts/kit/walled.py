"""The parent's end of the process that executes chains of tests: one for all chains, started when needed."""

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
    CloseWall,
    Deploy,
    Forget,
    MakeTrace,
    ReadFigures,
    ReadState,
    Request,
    Run,
    Withdraw,
)
from contracts.vm.model.faults import ContractSourceError
from contracts.worker.walled_process import WalledProcess
from contracts.worker.wire import SandboxFeature

_T = TypeVar("_T")
WORKER_MODULE = "contracts.kit.worker"


class _Worker:
    """The process, and who asks it: one at a time."""

    def __init__(self) -> None:
        self._process = WalledProcess(WORKER_MODULE)
        self._lock = threading.Lock()
        self._forgotten: list[int] = []
        self._numbers = itertools.count(1)
        atexit.register(self._process.close)
        self.parts = self.ask(CloseWall()).parts

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    def next_chain(self) -> int:
        """Return the number of a new chain."""
        return next(self._numbers)

    def forget(self, chain: int) -> None:
        """Let go of a chain at the next request: this may be called in the midst of one, by the garbage collector."""
        self._forgotten.append(chain)

    def ask(self, request: Request) -> Answer:
        """Raises CONTRACT_WORKER_FAILED; the next chain gets a new process then."""
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


class WalledEngine:
    """An `Engine` in the process behind the wall: the same methods, the same results and errors."""

    def __init__(self) -> None:
        """Raises CONTRACT_WORKER_FAILED."""
        self._worker = _worker()
        self._chain = self._worker.next_chain()
        weakref.finalize(self, self._worker.forget, self._chain)

    @property
    def parts(self) -> Sequence[SandboxFeature]:
        """The parts of the wall."""
        return self._worker.parts

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._worker.pid

    def deploy(self, source: str, name: str) -> str:
        """Put a source into force; return the entry that migrates from the version before, if there is one.

        Raises ContractSourceError.
        """
        answer = self._ask(Deploy(self._chain, source, name))
        if answer.problems:
            raise ContractSourceError(name, tuple(answer.problems))
        return answer.migrates_by

    def withdraw(self, name: str) -> None:
        """Go back to the version before, as a network does where a migration fails."""
        self._ask(Withdraw(self._chain, name))

    def run(self, call: Call, *, keep: bool) -> Ran:
        """Make a call; its writes stay if it succeeds and they are to be kept."""
        return _there(self._ask(Run(self._chain, call, keep)).ran)

    def trace(self, call: Call, who: str) -> Trace:
        """Return how a call by somebody goes on the present state, statement by statement, without making it."""
        return _there(self._ask(MakeTrace(self._chain, call, who)).trace)

    def read_state(self, contract: str) -> tuple[list[tuple[bytes, bytes]], bytes]:
        """Return what a contract has stored (its own keys, encoded values), and the 32-byte root of the whole state."""
        answer = self._ask(ReadState(self._chain, contract))
        return answer.rows, answer.state_root

    def figures(self) -> list[Figures]:
        """Return the figures of all sources that were deployed, in order."""
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
