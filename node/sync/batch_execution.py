"""Executes runs of finalized blocks ahead of the store, in a layer over a snapshot."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_GAS_MAX, BLOCK_SIZE_MAX_BYTES
from contracts.state.view import Overlay
from node.execution.block_executor import ExecutedBlock, Executor
from node.execution.execution_machines import BlockExecutionResult, CheckedBlock
from node.storage.ledger_store import LedgerSnapshot, LedgerStore
from node.sync.block_ranges import CheckedRange

GROUP_BLOCKS_MAX_COUNT = 64
"""How many blocks are executed in one go, if they are small: no more than two full ones would take."""


@dataclass(slots=True)
class _Run:
    top: int
    writes: dict[bytes, bytes | None]
    pages: dict[bytes, bytes | None]
    txids: set[bytes]


class _Spent:
    def __init__(self, above: set[bytes], ledger: LedgerSnapshot) -> None:
        self._above = above
        self._ledger = ledger

    def __contains__(self, txid: object, /) -> bool:
        return txid in self._above or (isinstance(txid, bytes) and self._ledger.locate(txid) is not None)


class CatchUp:
    """Executes runs from the stored head on; single-threaded, to be closed."""

    def __init__(self, ledger: LedgerStore, executor: Executor) -> None:
        self._ledger = ledger
        self._executor = executor
        self._snapshot = ledger.snapshot()
        position = self._snapshot.position
        if position is None:
            raise AssertionError("the ledger holds genesis")
        self.height, self.block_id = position.height, position.block_id
        self._time_ms = position.timestamp_ms
        self._root = position.state_root
        self._runs: deque[_Run] = deque()
        self._writes: dict[bytes, bytes | None] = {}
        self._pages: dict[bytes, bytes | None] = {}
        self._txids: set[bytes] = set()

    def close(self) -> None:
        self._snapshot.close()

    def execute(self, run: CheckedRange) -> list[ExecutedBlock]:
        """Execute what lies above the newest executed block. Raises BLOCK_INVALID."""
        self._rebase()
        fresh = [checked for checked in run.blocks if checked.header.height > self.height]
        if not fresh:
            return []
        if fresh[0].header.height != self.height + 1 or fresh[0].header.parent_id != self.block_id:
            raise BlockRobotError("BLOCK_INVALID", "The peer's blocks do not join on to those that are final here.")
        made = _Run(fresh[-1].header.height, {}, {}, set())
        executed: list[ExecutedBlock] = []
        for group in grouped(fresh):
            ahead = self._executor.execute_ahead(self._view(), group)
            executed += [self._execute_one(checked, made, result) for checked, result in zip_longest(group, ahead)]
        self._runs.append(made)
        return executed

    def _view(self) -> Overlay:
        return Overlay(self._snapshot, self._writes, self._pages, self._root)

    def _execute_one(self, checked: CheckedBlock, made: _Run, result: BlockExecutionResult | None) -> ExecutedBlock:
        parent, spent = self._view(), _Spent(self._txids, self._snapshot)
        executed = self._executor.execute_final(checked, parent, self._time_ms, spent, result)
        overlay, header = executed.overlay, checked.header
        for layer, writes in ((self._writes, overlay.writes), (made.writes, overlay.writes)):
            layer.update(writes)
        for layer, pages in ((self._pages, overlay.page_writes), (made.pages, overlay.page_writes)):
            layer.update(pages)
        self._txids |= executed.txids
        made.txids |= executed.txids
        self.height, self.block_id = header.height, checked.block_id
        self._time_ms, self._root = header.timestamp_ms, header.state_root
        return executed

    def _rebase(self) -> None:
        position = self._snapshot.position
        stored = self._ledger.position
        if stored is None or position is None or stored.height <= position.height:
            return
        if stored.height <= self.height and all(run.top > stored.height for run in self._runs):
            return
        newest = self._ledger.snapshot()
        reached = newest.position
        if reached is None:
            newest.close()
            return
        if reached.height > self.height:
            self.height, self.block_id = reached.height, reached.block_id
            self._time_ms, self._root = reached.timestamp_ms, reached.state_root
        while self._runs and self._runs[0].top <= reached.height:
            self._runs.popleft()
        previous, self._snapshot = self._snapshot, newest
        previous.close()
        self._writes = _merged([run.writes for run in self._runs])
        self._pages = _merged([run.pages for run in self._runs])
        self._txids = set().union(*(run.txids for run in self._runs))


def grouped(blocks: Sequence[CheckedBlock]) -> Iterator[list[CheckedBlock]]:
    """Yield groups smaller than two full blocks, executed in one go."""
    group: list[CheckedBlock] = []
    gas = size = 0
    for checked in blocks:
        group.append(checked)
        gas += checked.header.gas_used
        size += sum(len(transaction.wire) for transaction in checked.transactions)
        if gas >= BLOCK_GAS_MAX or size >= BLOCK_SIZE_MAX_BYTES or len(group) == GROUP_BLOCKS_MAX_COUNT:
            yield group
            group, gas, size = [], 0, 0
    if group:
        yield group


def _merged(layers: list[dict[bytes, bytes | None]]) -> dict[bytes, bytes | None]:
    merged: dict[bytes, bytes | None] = {}
    for layer in layers:
        merged.update(layer)
    return merged
