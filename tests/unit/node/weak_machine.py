"""A machine that fails as a worker without memory does: on calls and versions of one contract, until it may take enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from consensus.chain.transaction import Transaction
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.results import BlockResult, ExecutionFault
from contracts.lifecycle.applying_changes import find_activation
from contracts.state.view import StateView


class WeakMachine:
    """`needs` says what effort a call or a change takes; `is_weak` may change. In `tried` is what it failed on."""

    def __init__(self, inner: ContractMachine, contract: str, *, needs: int = 1) -> None:
        self._inner = inner
        self._contract = contract
        self.needs = needs
        self.is_weak = True
        self.tried: list[str] = []

    def _fail(self, what: str, **fault: Any) -> None:
        self.tried.append(what)
        raise ExecutionFault("it ended by signal 9", **fault)

    def _open(self, parent: StateView, height: int, time_ms: int, *, gives_up: bool, effort: int) -> None:
        change = find_activation(parent, height, time_ms)
        if self.is_weak and effort < self.needs and change is not None and change[0] == self._contract and not gives_up:
            self._fail("change", in_change=True)

    def _is_too_much(self, transaction: Transaction, effort: int) -> bool:
        return self.is_weak and effort < self.needs and transaction.body.contract == self._contract

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = lambda _place: None,
    ) -> tuple[BlockResult, list[bytes]]:
        self._open(parent, height, time_ms, gives_up=gives_up_change, effort=0)
        culprits = [transaction.txid for transaction in transactions if self._is_too_much(transaction, 0)]
        self.tried += ["build"] * len(culprits)
        sound = [transaction for transaction in transactions if transaction.txid not in culprits]
        result, _ = self._inner.build(parent, height, time_ms, sound, gives_up_change=gives_up_change, note=note)
        return result, culprits

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        effort: int = 0,
        note: Callable[[int], None] = lambda _place: None,
    ) -> BlockResult:
        self._open(parent, height, time_ms, gives_up=gives_up_change, effort=effort)
        for transaction in transactions:
            if self._is_too_much(transaction, effort):
                self._fail("verify", txid=transaction.txid)
        return self._inner.verify(parent, height, time_ms, transactions, gives_up_change=gives_up_change, note=note)
