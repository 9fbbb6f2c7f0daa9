"""Executes blocks for simulated nodes, and compares the results.

With `shares`, later verifiers reuse the first verifier's result.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TypeVar

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.results import BlockResult
from contracts.state.view import StateView
from network.sim.world.cpu import COSTS, charge

RESULTS_MAX_COUNT = 512

OnDifference = Callable[[int, str], None]
_Place = tuple[bytes, int, int, tuple[bytes, ...], bool]
_Outcome = tuple[bytes, bytes, int]
_Kept = TypeVar("_Kept")


class ComparingMachine:
    """The machine of all nodes; `on_difference(height, text)` reports differing executions."""

    def __init__(self, machine: ContractMachine, *, shares: bool, on_difference: OnDifference) -> None:
        self._machine = machine
        self._shares = shares
        self._on_difference = on_difference
        self._outcomes: OrderedDict[_Place, _Outcome] = OrderedDict()
        self._verified: OrderedDict[_Place, BlockResult] = OrderedDict()

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
    ) -> tuple[BlockResult, list[bytes]]:
        """Execute what fits into a block; the result is not shared with verifiers."""
        charge(COSTS.block + COSTS.execution * len(transactions))
        result, faulty = self._machine.build(parent, height, time_ms, transactions, gives_up_change=gives_up_change)
        txids = tuple(receipt.txid for receipt in result.receipts)
        self._compare((parent.state_root, height, time_ms, txids, gives_up_change), result)
        return result, faulty

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
        """Execute exactly these transactions, or reuse a verifier's result. Raises BLOCK_INVALID."""
        charge(COSTS.block + COSTS.execution * len(transactions))
        del effort
        txids = tuple(transaction.txid for transaction in transactions)
        place = (parent.state_root, height, time_ms, txids, gives_up_change)
        known = self._verified.get(place) if self._shares else None
        if known is not None:
            return known
        try:
            result = self._machine.verify(parent, height, time_ms, transactions, gives_up_change=gives_up_change)
        except BlockRobotError as error:
            if place in self._outcomes:
                self._on_difference(height, f"block {height} was executed once, and refused another time: {error.code}")
            raise
        self._compare(place, result)
        if self._shares:
            _keep(self._verified, place, result)
        return result

    def _compare(self, place: _Place, result: BlockResult) -> None:
        outcome = (result.state_root, result.receipt_root, result.gas_used)
        known = self._outcomes.get(place)
        if known is None:
            _keep(self._outcomes, place, outcome)
        elif known != outcome:
            names = ("state root", "receipts", "gas")
            differing = [name for name, one, other in zip(names, known, outcome, strict=True) if one != other]
            height = place[1]
            self._on_difference(height, f"block {height} was executed twice, with different {' and '.join(differing)}")


def _keep(kept: OrderedDict[_Place, _Kept], place: _Place, item: _Kept) -> None:
    kept[place] = item
    if len(kept) > RESULTS_MAX_COUNT:
        kept.popitem(last=False)
