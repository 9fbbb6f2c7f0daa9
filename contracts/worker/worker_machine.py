"""Runs a chain's contracts in worker processes; results equal `ContractMachine`'s.

Lost workers are replaced and asked again; a second failure gives `ExecutionFault`, no verdict.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.primitives.trie import hash_page
from contracts.execution.results import IN_CHANGE, BlockResult, ExecutionFault, ExpectedBlock
from contracts.state.view import StateReader, StateView
from contracts.vm import InternalFault
from contracts.worker.handle import ENDLESS, PROCESSOR_MAX_MS, STALLED_MAX_MS, WorkerHandle, WorkerLostError
from contracts.worker.sandbox import REQUIRED_PARTS
from contracts.worker.wire import (
    Begin,
    Broken,
    Execute,
    Executed,
    ExecutedRun,
    ExecuteRun,
    Refused,
    SandboxFeature,
    View,
    Viewed,
)

ATTEMPTS_MAX_COUNT = 2
STARTS_MAX_COUNT = 3
EFFORT_MAX = 4
"""The last step of effort that has a limit: sixteen times the memory and time."""
_RENEWAL_DIVISOR = 4
"""The ledger is read anew once it took a quarter of the blocks that the worker keeps above it."""


class Hold(Protocol):
    """A ledger snapshot: while open, pages read by a worker are not reused."""

    def close(self) -> None: ...


class Ledger(Protocol):
    """The ledger for block execution, shared with the worker."""

    def height(self) -> int:
        """-1 if there is none."""
        ...

    def hold(self) -> Hold: ...


@dataclass(frozen=True, slots=True)
class WorkerSpec:
    """How to start workers: command, first message, listener for replacements."""

    command: Sequence[str]
    begin: Begin
    note_loss: Callable[[str], None] = lambda _reason: None
    stalled_max_ms: int = STALLED_MAX_MS


class _WorkerSlot:
    def __init__(self, staff: WorkerSpec) -> None:
        self._staff = staff
        self._handle: WorkerHandle | None = None
        self._spare: WorkerHandle | None = None
        self._effort = 0
        self._closed = False
        self.parts: tuple[SandboxFeature, ...] = ()
        self.replaced_count = 0
        self.last_loss = ""

    @property
    def pid(self) -> int | None:
        return None if self._handle is None else self._handle.pid

    def worker(self, effort: int = 0) -> WorkerHandle:
        if self._closed:
            raise InternalFault("the node is closing")
        if self._handle is not None and effort != self._effort:
            self._let_go()
        if self._handle is None:
            if effort == 0 and self._spare is not None:
                self._handle, self._spare = self._spare, None
                self._keep_spare()
            else:
                self._handle = self._start(effort)
            self._effort = effort
        return self._handle

    def _start(self, effort: int) -> WorkerHandle:
        staff, is_limited = self._staff, effort <= EFFORT_MAX
        memory_max_bytes = staff.begin.memory_max_bytes << effort if is_limited else 0
        begin = Begin(staff.begin.genesis_json, staff.begin.ledger_dir, memory_max_bytes)
        processor_max_ms = PROCESSOR_MAX_MS << effort if is_limited else None
        return WorkerHandle(
            staff.command, begin, stalled_max_ms=staff.stalled_max_ms, processor_max_ms=processor_max_ms
        )

    def newest_place(self) -> int | None:
        return None if self._handle is None else self._handle.newest_place()

    def _let_go(self) -> None:
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.end()

    def greet(self, effort: int = 0) -> None:
        self.parts = self.worker(effort).hello().parts

    def dismiss(self, reason: str) -> None:
        self._let_go()
        self.replaced_count += 1
        self.last_loss = "".join(character if character.isprintable() else "?" for character in reason)
        self._keep_spare()
        self._staff.note_loss(reason)

    def _keep_spare(self) -> None:
        if self._spare is None and not self._closed:
            with contextlib.suppress(WorkerLostError):
                self._spare = self._start(0)

    def close(self) -> None:
        self._closed = True
        self._let_go()
        if self._spare is not None:
            self._spare.end()
            self._spare = None

    def describe(self) -> dict[str, Any]:
        return {
            "pid": self.pid,
            "replaced": self.replaced_count,
            "last_loss": self.last_loss,
            "missing": {part.name: part.detail for part in self.parts if not part.had},
        }


class WorkerMachine:
    """Builds and verifies blocks in a worker; thread-safe, serves one at a time."""

    def __init__(self, staff: WorkerSpec, ledger: Ledger) -> None:
        """Start the worker without waiting for it."""
        self._post = _WorkerSlot(staff)
        self._ledger = ledger
        self._lock = threading.Lock()
        self._hold: Hold | None = ledger.hold()
        self._base_height: int | None = None
        self._layers_count = 0
        self._effort = 0
        try:
            self._post.worker()
        except WorkerLostError as error:
            self._post.dismiss(error.reason)

    def greet(self) -> tuple[SandboxFeature, ...]:
        """Raises CONTRACT_WORKER_FAILED."""
        with self._lock:
            for _ in range(STARTS_MAX_COUNT):
                try:
                    self._post.greet()
                except WorkerLostError as error:
                    self._dismiss(error.reason)
                    reason = error.reason
                else:
                    return self._post.parts
        raise BlockRobotError("CONTRACT_WORKER_FAILED", f"The worker that runs contracts could not start: {reason}.")

    def describe(self) -> dict[str, Any]:
        """Return worker pid, number of replacements, and missing sandbox parts."""
        return self._post.describe()

    def close(self) -> None:
        with self._lock:
            self._post.close()
            if self._hold is not None:
                self._hold.close()
                self._hold = None

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
    ) -> tuple[BlockResult, list[bytes]]:
        """Execute what fits into a block, in order; return it and the txids that failed.

        A failing transaction ends the block before it. Raises ExecutionFault for other failures.
        """
        try:
            return self._execute(
                parent, height, time_ms, transactions, leader=True, gives_up_change=gives_up_change
            ), []
        except ExecutionFault as fault:
            txids = [transaction.txid for transaction in transactions]
            if fault.txid is None:
                raise
            place, culprits = txids.index(fault.txid), [fault.txid]
        before = transactions[:place]
        result = self._execute(parent, height, time_ms, before, leader=True, gives_up_change=gives_up_change)
        return replace(result, left_out=(*result.left_out, *txids[place:]), faulty=tuple(culprits)), culprits

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        effort: int = 0,
    ) -> BlockResult:
        """Execute exactly these transactions; each `effort` step doubles the limits.

        Raises BLOCK_INVALID if they do not fit, ExecutionFault (no verdict, no vote) if interpreter or process fails.
        """
        return self._execute(
            parent, height, time_ms, transactions, leader=False, gives_up_change=gives_up_change, effort=effort
        )

    def verify_ahead(self, parent: StateView, blocks: Sequence[ExpectedBlock]) -> list[BlockResult]:
        """Verify consecutive blocks in one message; any failure shortens the result, possibly to empty."""
        questions, root = [], parent.state_root
        with self._lock:
            renew = bool(blocks) and (self._effort != 0 or self._is_renewal_due())
            for number, block in enumerate(blocks):
                wires = tuple((transaction.txid, transaction.wire) for transaction in block.transactions)
                is_renewing = renew and number == 0
                questions.append(
                    Execute(root, block.height, block.time_ms, wires, False, is_renewing, block.gives_up_change)
                )
                root = block.state_root
            try:
                answer, _ = self._ask(ExecuteRun(tuple(questions)), parent, renew=renew)
            except WorkerLostError as error:
                self._dismiss(error.reason)
                return []
            if isinstance(answer, Broken):
                self._dismiss(answer.text)
        if not isinstance(answer, ExecutedRun):
            return []
        return [_result_of(executed) for executed in answer.blocks[: len(blocks)]]

    def _execute(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        leader: bool,
        gives_up_change: bool,
        effort: int = 0,
    ) -> BlockResult:
        wires = tuple((transaction.txid, transaction.wire) for transaction in transactions)
        reason, place, first, is_spent = "", None, effort, False
        with self._lock:
            for attempt in range(1, ATTEMPTS_MAX_COUNT + EFFORT_MAX + 2):
                renew = effort != self._effort or self._is_renewal_due()
                question = Execute(
                    parent.state_root, height, time_ms, wires, leader, renew, gives_up_change=gives_up_change
                )
                try:
                    answer, is_new = self._ask(question, parent, renew=renew, effort=effort)
                except WorkerLostError as error:
                    answer, is_new, reason, place = None, False, error.reason, error.place
                    is_spent = reason == ENDLESS
                if isinstance(answer, Executed):
                    return _result_of(answer)
                if isinstance(answer, Refused):
                    if not answer.code.startswith("STORAGE_"):
                        raise BlockRobotError(answer.code, answer.detail)
                    reason, place, is_new = f"{answer.code}: {answer.detail}", None, False
                elif isinstance(answer, Broken):
                    reason, place = answer.text, self._post.newest_place()
                    is_spent = answer.exhausted
                self._dismiss(reason)
                if place is not None and (is_new or is_spent or attempt >= ATTEMPTS_MAX_COUNT):
                    break
                if place is None and attempt >= ATTEMPTS_MAX_COUNT:
                    effort = min(effort + 1, max(first, EFFORT_MAX + 1))
        txid = transactions[place].txid if place is not None and 0 <= place < len(transactions) else None
        raise ExecutionFault(f"the block could not be executed: {reason}", txid=txid, in_change=place == IN_CHANGE)

    def _is_renewal_due(self) -> bool:
        if self._base_height is None:
            return True
        return self._ledger.height() - self._base_height > self._layers_count // _RENEWAL_DIVISOR

    def _ask(
        self, question: Execute | ExecuteRun, parent: StateView, *, renew: bool, effort: int = 0
    ) -> tuple[Executed | ExecutedRun | Refused | Broken, bool]:
        hold = self._ledger.hold() if renew else None
        try:
            worker = self._post.worker(effort)
            self._effort = effort
            is_new = worker.answers_count == 0
            if is_new:
                self._post.greet(effort)
            answer = worker.ask(question, parent)
        except BaseException as error:
            if hold is not None:
                hold.close()
            if not isinstance(error, WorkerLostError):
                self._dismiss("what it asked for could not be read")  # it still waits for the answer
            raise
        if hold is not None:
            if self._hold is not None:
                self._hold.close()
            self._hold = hold
        if isinstance(answer, Viewed):
            raise WorkerLostError("it answered a view, and was asked for a block")
        for executed in answer.blocks if isinstance(answer, ExecutedRun) else (answer,):
            if isinstance(executed, Executed):
                _require_sound(executed)
                self._base_height, self._layers_count = executed.base_height, executed.layers_count
        return answer, is_new

    def _dismiss(self, reason: str) -> None:
        self._base_height, self._layers_count = None, 0
        self._post.dismiss(reason)


class WorkerViews:
    """Answers views in a worker started on demand; one thread at a time."""

    def __init__(self, staff: WorkerSpec) -> None:
        self._post = _WorkerSlot(staff)
        self._lock = threading.Lock()

    def run_view(
        self, state: StateReader, root: bytes, height: int, time_ms: int, contract: str, view: str, arguments: list[Any]
    ) -> bytes:
        """On an open ledger snapshot with this root.

        Raises as `contracts.execution.views.run_view`, or CONTRACT_WORKER_FAILED.
        """
        question, reason = View(root, height, time_ms, contract, view, encode_value(arguments)), ""
        with self._lock:
            for _ in range(STARTS_MAX_COUNT):
                try:
                    worker = self._post.worker()
                    is_new = worker.answers_count == 0
                    if is_new:
                        self._post.greet()
                    answer = worker.ask(question, state)
                except WorkerLostError as error:
                    reason = error.reason
                    self._post.dismiss(reason)
                    continue
                except BaseException:
                    self._post.dismiss("what it asked for could not be read")
                    raise
                if isinstance(answer, Viewed):
                    return answer.result
                if isinstance(answer, Refused) and not answer.code.startswith("STORAGE_"):
                    raise BlockRobotError(answer.code, answer.detail)
                reason = answer.text if isinstance(answer, Broken) else "it could not read the ledger"
                self._post.dismiss(reason)
                if is_new:
                    break
        raise BlockRobotError("CONTRACT_WORKER_FAILED", f"The view could not be run: {reason}.")

    def describe(self) -> dict[str, Any]:
        return self._post.describe()

    def close(self) -> None:
        with self._lock:
            self._post.close()


def missing_parts(parts: Sequence[SandboxFeature]) -> dict[str, str]:
    return {part.name: part.detail for part in parts if not part.had and part.name in REQUIRED_PARTS}


def _require_sound(answer: Executed) -> None:
    """Check an answer's root against its root page. Raises WorkerLostError."""
    page = answer.page_writes.get(b"")
    if page is not None and hash_page(page) != answer.state_root:
        raise WorkerLostError("it spoke nonsense: the state root is not that of its page")


def _result_of(answer: Executed) -> BlockResult:
    return BlockResult(
        receipts=answer.receipts,
        writes=answer.writes,
        page_writes=answer.page_writes,
        state_root=answer.state_root,
        receipt_root=answer.receipt_root,
        gas_used=answer.gas_used,
        left_out=answer.left_out,
    )
