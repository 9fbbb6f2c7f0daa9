"""The contract worker's main loop; contracts run only inside the sandbox.

Everything is loaded before the sandbox closes; no file can be opened later.
"""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import msgspec

from consensus.chain.transaction import Transaction, TransactionBody, TransactionWire
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from contracts.execution.results import BlockResult, ExecutionFault, note_nothing
from contracts.state.key_cache import prefix_end
from contracts.state.view import StateReader, StateView
from contracts.worker.layers import Layers
from contracts.worker.sandbox import enter_sandbox
from contracts.worker.wire import (
    FROM_NODE,
    Begin,
    Broken,
    Execute,
    Executed,
    ExecutedRun,
    ExecuteRun,
    FromNode,
    Get,
    Hello,
    Page,
    Pipe,
    Refused,
    Rows,
    Scan,
    Value,
    View,
    Viewed,
    pack_place,
)

_WIRE = msgspec.msgpack.Decoder(TransactionWire)
_BODY = msgspec.msgpack.Decoder(TransactionBody)
_NOTES_FD = 2
ASKED_ROWS_MAX_COUNT = 64
ASKED_KEPT_MAX_BYTES = 8 * 1_048_576


class LedgerView(StateView, Protocol):
    """The stored ledger at one position, until closed."""

    @property
    def height(self) -> int: ...

    def close(self) -> None: ...


class BlockMachine(Protocol):
    """Executes blocks, like `contracts.execution.contract_machine.ContractMachine`."""

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = note_nothing,
    ) -> tuple[BlockResult, list[bytes]]: ...

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = note_nothing,
    ) -> BlockResult: ...


@dataclass(frozen=True, slots=True)
class WorkerTools:
    """A worker's tools; `run_view(state, height, time_ms, contract, view, arguments)` gives encoded bytes."""

    machine: BlockMachine
    run_view: Callable[[StateReader, int, int, str, str, list[Any]], bytes]
    open_ledger: Callable[[], LedgerView]
    kept_files: tuple[Path, ...]


class RemoteState:
    """The parent's state fetched from the node row by row: always right, but slow."""

    def __init__(self, pipe: Pipe, state_root: bytes) -> None:
        self._pipe = pipe
        self.state_root = state_root
        self._kept: dict[bytes, bytes] = {}
        self._kept_bytes = 0

    def _ask(self, question: Get | Page | Scan) -> FromNode:
        self._pipe.send(question)
        return self._pipe.receive(FROM_NODE)

    def _value(self, question: Get | Page) -> bytes | None:
        answer = self._ask(question)
        if not isinstance(answer, Value):
            raise BlockRobotError("STORAGE_DAMAGED", "The node answered something else than a value.")
        return answer.data

    def get(self, key: bytes) -> bytes | None:
        kept = self._kept.get(key)
        return self._value(Get(key)) if kept is None else kept

    def page(self, path: bytes) -> bytes | None:
        return self._value(Page(path))

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return islice(self.scan_range(prefix, prefix_end(prefix)), limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield pairs in [start, end) in key order, fetched piecewise."""
        count = 1
        while True:
            answer = self._ask(Scan(start, end, count))
            if not isinstance(answer, Rows):
                raise BlockRobotError("STORAGE_DAMAGED", "The node answered something else than rows.")
            for row in answer.rows:
                self._keep(*row)
                yield row
            if len(answer.rows) < count:
                return
            start = answer.rows[-1][0] + b"\x00"
            count = min(2 * count, ASKED_ROWS_MAX_COUNT)

    def _keep(self, key: bytes, value: bytes) -> None:
        if self._kept_bytes > ASKED_KEPT_MAX_BYTES:
            self._kept.clear()
            self._kept_bytes = 0
        if key not in self._kept:
            self._kept[key] = value
            self._kept_bytes += len(value)


def _note(place: int) -> None:
    """Note what comes next for the node; never blocks."""
    with contextlib.suppress(OSError):
        os.write(_NOTES_FD, pack_place(place))


class _Worker:
    def __init__(self, pipe: Pipe, place: WorkerTools) -> None:
        self._pipe = pipe
        self._place = place
        self._layers = Layers()
        self._ledger: LedgerView | None = None

    def answer(self, message: FromNode) -> Executed | ExecutedRun | Viewed | Refused | Broken:
        try:
            if isinstance(message, Execute):
                return self._execute(message)
            if isinstance(message, ExecuteRun):
                return self._execute_run(message)
            if isinstance(message, View):
                return self._view(message)
        except BlockRobotError as error:
            return Refused(error.code, error.detail)
        except (EOFError, BrokenPipeError):
            raise
        except Exception as error:  # noqa: BLE001 - whatever it was, it is no verdict, and the node decides what to do
            text = f"{type(error).__name__}: {error}".encode("ascii", "backslashreplace").decode()[:1000]
            return Broken(text, exhausted=_is_exhaustion(error))
        raise AssertionError("the node answers only what it was asked")

    def _renew(self) -> LedgerView:
        if self._ledger is not None:
            self._ledger.close()
            self._ledger = None
        self._ledger = ledger = self._place.open_ledger()
        self._layers.stand_on(ledger.state_root)
        return ledger

    def _execute(self, message: Execute, *, asks: bool = True) -> Executed:
        ledger = self._renew() if message.renew or self._ledger is None else self._ledger
        parent: StateView | None = self._layers.view(ledger, message.parent_root)
        if parent is None:
            if not asks:
                raise LookupError("the parent's state is not known here")
            parent = RemoteState(self._pipe, message.parent_root)
        transactions = [_read_transaction(txid, wire) for txid, wire in message.transactions]
        execute, place = self._place.machine, (parent, message.height, message.time_ms, transactions)
        gives_up, note = message.gives_up_change, _note if asks else note_nothing
        if message.leader:
            result, faulty = execute.build(*place, gives_up_change=gives_up, note=note)
            if faulty:
                _note(next(number for number, one in enumerate(transactions) if one.txid == faulty[0]))
                raise ExecutionFault(str(result.fault)) from result.fault  # nothing it did since is believed
        else:
            result = execute.verify(*place, gives_up_change=gives_up, note=note)
        writes, pages = dict(result.writes), dict(result.page_writes)
        self._layers.add(ledger.state_root, message.parent_root, result.state_root, writes, pages)
        return Executed(
            receipts=result.receipts,
            writes=writes,
            page_writes=pages,
            state_root=result.state_root,
            receipt_root=result.receipt_root,
            gas_used=result.gas_used,
            left_out=result.left_out,
            base_height=ledger.height,
            layers_count=self._layers.count,
        )

    def _execute_run(self, message: ExecuteRun) -> ExecutedRun:
        done: list[Executed] = []
        for block in message.blocks:
            if done and done[-1].state_root != block.parent_root:
                break
            try:
                done.append(self._execute(block, asks=not done))
            except (BlockRobotError, LookupError):
                if not done:
                    raise
                break
        return ExecutedRun(tuple(done))

    def _view(self, message: View) -> Viewed:
        ledger = self._renew()
        state: StateView = ledger if ledger.state_root == message.root else RemoteState(self._pipe, message.root)
        arguments = decode_value(message.arguments)
        if not isinstance(arguments, list):
            raise BlockRobotError("REQUEST_INVALID", "The arguments are not an encoded list.")
        run = self._place.run_view
        return Viewed(run(state, message.height, message.time_ms, message.contract, message.view, arguments))


def _is_exhaustion(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, MemoryError):
        error = error.__cause__
    return error is not None


def _read_transaction(txid: bytes, wire: bytes) -> Transaction:
    outer = _WIRE.decode(wire)
    body = _BODY.decode(outer.body)
    return Transaction(wire=wire, body=body, signature=outer.signature, txid=txid, body_bytes=outer.body)


def serve(pipe: Pipe, prepare: Callable[[Begin], WorkerTools]) -> None:
    """Serve until the pipe ends: `Begin`, then `Hello` once sandboxed, then one answer per message."""
    begin = pipe.receive(FROM_NODE)
    if not isinstance(begin, Begin):
        raise ValueError("the first message of a node is the beginning")
    place = prepare(begin)
    gc.collect()
    gc.freeze()
    os.set_blocking(_NOTES_FD, False)  # the sandbox forbids it
    pipe.send(Hello(enter_sandbox(place.kept_files, begin.memory_max_bytes)))
    worker = _Worker(pipe, place)
    while True:
        try:
            pipe.send(worker.answer(pipe.receive(FROM_NODE)))
        except (EOFError, BrokenPipeError):
            return
