"""Executes a block's transactions one after another on its parent's state. Must never let time or chance decide a result.

Each call runs over an overlay of its own: if it fails, nothing remains but its receipt. An exception that the
interpreter did not foresee gives no receipt at all: a leader leaves that transaction out, a voter raises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from consensus.block import ContractEvent, Receipt, compute_receipts_root
from consensus.errors import BlockRobotError
from consensus.transaction import Transaction
from contracts.execution.call_host import CallHost
from contracts.execution.catalogue import ActiveContracts
from contracts.execution.changed_calls import ARGUMENTS_INVALID, ENTRY_UNKNOWN, explain_absence, explain_call
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext, BlockResult, ExecutionLimits
from contracts.state.trie import apply_batch
from contracts.state.view import StateView
from contracts.vm import CallContext, CompiledContract, InternalFault, Outcome, invoke

UNKNOWN_CONTRACT_GAS = 100
EXPLANATION_GAS = 1_000

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


def _no_contract(transaction: Transaction, contracts: Contracts) -> Receipt:
    code, message = explain_absence(contracts, transaction.body.contract)
    return Receipt(
        txid=transaction.txid,
        ok=False,
        code=code,
        message=message,
        line=None,
        gas_used=UNKNOWN_CONTRACT_GAS,
        events=(),
    )


def execute_transaction(
    host: CallHost, contracts: Contracts, context: BlockContext, transaction: Transaction, gas_limit: int
) -> Receipt:
    """Run one transaction on the host. Its writes wait there for `host.keep()`; a failed call's must not be kept.

    Raises InternalFault if the interpreter itself failed.
    """
    body = transaction.body
    host.begin()
    if body.contract not in contracts:
        return _no_contract(transaction, contracts)
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
        gas_limit=gas_limit,
        mode="export",
    )
    if outcome.code in (ENTRY_UNKNOWN, ARGUMENTS_INVALID) and isinstance(contracts, ActiveContracts):
        told = explain_call(host, contracts, body.contract, body.entry, transaction.arguments())
        if told is not None:
            gas_used = min(outcome.gas_used + EXPLANATION_GAS, gas_limit)
            outcome = replace(outcome, message=told[1], gas_used=gas_used)
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
) -> BlockResult:
    """Execute transactions in order and return what they make of the parent's state.

    `host` holds what the block did before them (see `contracts.execution.opening`), if it did anything.
    A leader leaves out what the interpreter fails on, and stops at the first that no longer fits. For a
    voter both are reasons to refuse the block: raises InternalFault or BLOCK_INVALID.
    """
    host = CallHost(parent) if host is None else host
    receipts: list[Receipt] = []
    faulty: list[bytes] = []
    gas_used = 0
    unfitting: Sequence[Transaction] = ()
    for place, transaction in enumerate(transactions):
        if len(receipts) == limits.transactions_count:
            unfitting = transactions[place:]
            break
        try:
            receipt = execute_transaction(host, contracts, context, transaction, limits.call_gas)
        except InternalFault:
            if not leader:
                raise
            faulty.append(transaction.txid)
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
    )
