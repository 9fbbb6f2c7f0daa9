"""What the execution of a block takes and gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from consensus.chain.block import Receipt
from consensus.chain.transaction import Transaction
from consensus.limits import BLOCK_GAS_MAX, BLOCK_TRANSACTIONS_MAX_COUNT, CALL_GAS_MAX
from contracts.vm.model.faults import InternalFault

IN_CHANGE = -1
"""What an execution notes while a change of contracts takes effect; otherwise the place of the transaction."""


class ExecutionFault(InternalFault):
    """A block could not be executed: no verdict. `txid` or `in_change` say what was in hand, if that is known."""

    def __init__(self, reason: str, *, txid: bytes | None = None, in_change: bool = False) -> None:
        self.reason, self.txid, self.in_change = reason, txid, in_change
        super().__init__(reason)


def note_nothing(_place: int) -> None:
    """Note nothing of how far an execution is."""


@dataclass(frozen=True, slots=True)
class BlockContext:
    """What contracts may know of the block they run in: chain id (32 bytes), height, timestamp in ms."""

    chain_id: bytes
    height: int
    time_ms: int


@dataclass(frozen=True, slots=True)
class ExpectedBlock:
    """A block of somebody else, and the state root that it says it gives: the next one stands on that."""

    height: int
    time_ms: int
    transactions: Sequence[Transaction]
    state_root: bytes
    gives_up_change: bool = False


@dataclass(frozen=True, slots=True)
class ExecutionLimits:
    """How much one call and one block may use up, and how many transactions a block takes."""

    call_gas: int = CALL_GAS_MAX
    block_gas: int = BLOCK_GAS_MAX
    transactions_count: int = BLOCK_TRANSACTIONS_MAX_COUNT


PROTOCOL_LIMITS = ExecutionLimits()


@dataclass(frozen=True, slots=True)
class BlockResult:
    """What a block does to its parent's state. Receipts stand for the transactions that were executed, in order.

    `left_out` names the transactions without a receipt: `faulty` are those that no block should ever hold, since the
    interpreter itself failed on them (`fault`: how, on the first); the others no longer fitted. Both are empty for a valid
    block of somebody else.
    """

    receipts: tuple[Receipt, ...]
    writes: Mapping[bytes, bytes | None]
    page_writes: Mapping[bytes, bytes | None]
    state_root: bytes
    receipt_root: bytes
    gas_used: int
    left_out: tuple[bytes, ...] = ()
    faulty: tuple[bytes, ...] = ()
    fault: InternalFault | None = None
