"""Executes blocks where a lack of memory or time decides nothing."""

from __future__ import annotations

from consensus.chain.block import Header
from consensus.chain.transaction import Transaction
from contracts.execution.results import ExecutionFault
from contracts.lifecycle.applying_changes import find_activation
from contracts.state.view import StateView
from node.execution.execution_machines import BlockExecutionResult, CheckedBlock, Machine
from node.mempool.quarantine import Change, Quarantine


class ExecutionRetries:
    """One node's machine and its memory of failed executions."""

    def __init__(self, machine: Machine, quarantine: Quarantine) -> None:
        self._machine = machine
        self._quarantine = quarantine

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: list[Transaction],
        *,
        is_hopeless: bool,
    ) -> tuple[BlockExecutionResult, list[bytes], bool]:
        """Return the outcome, failed txids, and whether a change is given up.

        R42: if it failed here, or `is_hopeless`. Raises ExecutionFault.
        """
        gives_up = self._failing_change(parent, height, time_ms) is not None
        gives_up = gives_up or (is_hopeless and find_activation(parent, height, time_ms) is not None)
        try:
            result, faulty = self._machine.build(parent, height, time_ms, transactions, gives_up_change=gives_up)
        except ExecutionFault as fault:
            self._note_fault(fault, parent, height, time_ms)
            if not fault.in_change or gives_up:
                raise
            gives_up = True
            result, faulty = self._machine.build(parent, height, time_ms, transactions, gives_up_change=True)
        for txid in faulty:
            self._quarantine.note_failure(txid, "the execution of an own block failed on it")
        return result, faulty, gives_up

    def verify(self, checked: CheckedBlock, parent: StateView, *, certified: bool) -> BlockExecutionResult:
        """Execute exactly this block, with more effort after failures. Raises ExecutionFault, BLOCK_INVALID."""
        header, block_id = checked.header, checked.block_id
        effort = self._quarantine.failures_of(block_id)
        try:
            result = self._machine.verify(
                parent,
                header.height,
                header.timestamp_ms,
                list(checked.transactions),
                gives_up_change=header.gives_up_change,
                effort=effort,
            )
        except ExecutionFault as fault:
            self._quarantine.note_block(block_id, header.height, fault.reason, certified=certified)
            self._note_fault(fault, parent, header.height, header.timestamp_ms)
            raise
        if effort:
            self._quarantine.forget_block(block_id)
        return result

    def require_not_failed_before(self, checked: CheckedBlock, parent: StateView) -> None:
        """R41: raise ExecutionFault for work that cost a worker before."""
        header = checked.header
        if not header.gives_up_change and self._failing_change(parent, header.height, header.timestamp_ms):
            raise ExecutionFault("the change of contracts that is due failed here before", in_change=True)
        txid = self._quarantine.find_failing(transaction.txid for transaction in checked.transactions)
        if txid is not None:
            raise ExecutionFault("the block holds a transaction that failed here before", txid=txid)

    def _failing_change(self, parent: StateView, height: int, time_ms: int) -> Change | None:
        change = find_activation(parent, height, time_ms) if self._quarantine.has_failed_changes else None
        return change if change is not None and self._quarantine.has_failed(change) else None

    def can_change(self, parent: StateView, header: Header) -> bool:
        """R42: return whether this node can carry out the given-up change."""
        if self._failing_change(parent, header.height, header.timestamp_ms):
            return False
        try:
            self._machine.verify(parent, header.height, header.timestamp_ms, [])
        except ExecutionFault as fault:
            self._note_fault(fault, parent, header.height, header.timestamp_ms)
            return not fault.in_change
        return True

    def _note_fault(self, fault: ExecutionFault, parent: StateView, height: int, time_ms: int) -> None:
        if fault.txid is not None:
            self._quarantine.note_failure(fault.txid, fault.reason)
        elif fault.in_change and (change := find_activation(parent, height, time_ms)) is not None:
            self._quarantine.note_change(change, fault.reason)
