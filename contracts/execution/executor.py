"""Executes transactions in order, each over its own overlay; failures leave only a receipt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from msgspec.structs import replace

from consensus.chain.block import ContractEvent, Receipt, compute_receipts_root
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.state.producers import EPOCH
from contracts.execution.call_host import CallHost
from contracts.execution.epochs import is_fit_to_follow
from contracts.execution.results import (
    PROTOCOL_LIMITS,
    BlockContext,
    BlockResult,
    ExecutionFault,
    ExecutionLimits,
    note_nothing,
)
from contracts.lifecycle.catalogue import ActiveContracts
from contracts.lifecycle.changed_calls import ARGUMENTS_INVALID, ENTRY_UNKNOWN, explain_absence, explain_call
from contracts.state.trie import apply_batch
from contracts.state.view import StateView
from contracts.vm import CallContext, CompiledContract, InternalFault, Outcome, invoke

UNKNOWN_CONTRACT_GAS = 100
WIRE_BYTES_A_GAS = 4
"""Every node keeps a transaction's bytes for a year, whatever the call comes to: so many of them cost one unit."""
EXPLANATION_GAS = 1_000
EPOCH_INVALID = "EPOCH_INVALID"
_EPOCH_REFUSED = "The chain could not go on with the producers or settings that this call wrote."

Contracts = Mapping[str, CompiledContract]


def _receipt_of(transaction: Transaction, outcome: Outcome) -> Receipt:
    events = tuple(ContractEvent(contract=contract, name=name, data=data) for contract, name, data in outcome.events)
    return Receipt(
        txid=transaction.txid,
        ok=outcome.ok,
        code=outcome.code,
        message=outcome.message,
        line=outcome.line,
        gas_used=outcome.gas_used,
        events=events if outcome.ok else (),
    )


def _no_contract(transaction: Transaction, contracts: Contracts, wire_gas: int, gas_limit: int) -> Receipt:
    code, message = explain_absence(contracts, transaction.body.contract)
    return Receipt(
        txid=transaction.txid,
        ok=False,
        code=code,
        message=message,
        line=None,
        gas_used=min(wire_gas + UNKNOWN_CONTRACT_GAS, gas_limit),
        events=(),
    )


def execute_transaction(
    host: CallHost, contracts: Contracts, context: BlockContext, transaction: Transaction, gas_limit: int
) -> Receipt:
    """Run one transaction; keep writes with `host.keep()` only on success. Raises InternalFault."""
    body = transaction.body
    host.begin()
    wire_gas = min(len(transaction.wire) // WIRE_BYTES_A_GAS, gas_limit)
    if body.contract not in contracts:
        return _no_contract(transaction, contracts, wire_gas, gas_limit)
    call = CallContext(
        caller=body.sender,
        height=context.height,
        time_ms=context.time_ms,
        txid=transaction.txid,
        chain_id=context.chain_id,
    )
    outcome = invoke(
        contracts,
        body.contract,
        body.entry,
        transaction.arguments(),
        host=host,
        context=call,
        gas_limit=gas_limit - wire_gas,
        mode="export",
    )
    outcome = replace(outcome, gas_used=wire_gas + outcome.gas_used)
    if outcome.code in (ENTRY_UNKNOWN, ARGUMENTS_INVALID) and isinstance(contracts, ActiveContracts):
        explanation = explain_call(host, contracts, body.contract, body.entry, transaction.arguments())
        if explanation is not None:
            gas_used = min(outcome.gas_used + EXPLANATION_GAS, gas_limit)
            outcome = replace(outcome, message=explanation[1], gas_used=gas_used)
    if outcome.ok and host.has_written(EPOCH.flat):
        before = host.get_before(EPOCH.flat)
        if before is not None and not is_fit_to_follow(before, host.get(EPOCH.flat)):
            outcome = replace(outcome, ok=False, code=EPOCH_INVALID, message=_EPOCH_REFUSED)
    return _receipt_of(transaction, outcome)


def execute_block(
    parent: StateView,
    contracts: Contracts,
    context: BlockContext,
    transactions: Sequence[Transaction],
    *,
    limits: ExecutionLimits = PROTOCOL_LIMITS,
    leader: bool = False,
    host: CallHost | None = None,
    note: Callable[[int], None] = note_nothing,
) -> BlockResult:
    """Execute transactions in order; `host` holds the block's earlier writes.

    Leaders omit faulty ones and stop when full; voters raise ExecutionFault or BLOCK_INVALID. `note` gets each place
    first.
    """
    host = CallHost(parent) if host is None else host
    receipts: list[Receipt] = []
    faulty: list[bytes] = []
    fault: InternalFault | None = None
    gas_used = 0
    unfitting: Sequence[Transaction] = ()
    for place, transaction in enumerate(transactions):
        if len(receipts) == limits.transactions_count:
            unfitting = transactions[place:]
            break
        note(place)
        try:
            receipt = execute_transaction(host, contracts, context, transaction, limits.call_gas)
        except InternalFault as error:
            if not leader:
                raise ExecutionFault(str(error), txid=transaction.txid) from error
            faulty.append(transaction.txid)
            fault = fault or error
            continue
        if gas_used + receipt.gas_used > limits.block_gas:
            unfitting = transactions[place:]
            break
        gas_used += receipt.gas_used
        receipts.append(receipt)
        if receipt.ok:
            host.keep()
    if unfitting and not leader:
        raise BlockRobotError("BLOCK_INVALID", "The block holds more than a block may use up.")
    update = apply_batch(parent, parent.state_root, host.writes)
    return BlockResult(
        receipts=tuple(receipts),
        writes=host.writes,
        page_writes=update.pages,
        state_root=update.root,
        receipt_root=compute_receipts_root(tuple(receipts)),
        gas_used=gas_used,
        left_out=(*faulty, *(transaction.txid for transaction in unfitting)),
        faulty=tuple(faulty),
        fault=fault,
    )
