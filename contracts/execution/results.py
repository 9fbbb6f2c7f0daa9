"""Inputs and results of block execution."""

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
    """Execution failed without a verdict; `txid` or `in_change` locate it if known."""

    def __init__(self, reason: str, *, txid: bytes | None = None, in_change: bool = False) -> None:
        self.reason, self.txid, self.in_change = reason, txid, in_change
        super().__init__(reason)


def note_nothing(_place: int) -> None: ...


@dataclass(frozen=True, slots=True)
class BlockContext:
    """A block's chain id (32 bytes), height and timestamp (ms), visible to contracts."""

    chain_id: bytes
    height: int
    time_ms: int


@dataclass(frozen=True, slots=True)
class ExpectedBlock:
    """Another's block and claimed state root, on which the next builds."""

    height: int
    time_ms: int
    transactions: Sequence[Transaction]
    state_root: bytes
    gives_up_change: bool = False


@dataclass(frozen=True, slots=True)
class ExecutionLimits:
    """Resource limits per call and block, and transactions per block."""

    call_gas: int = CALL_GAS_MAX
    block_gas: int = BLOCK_GAS_MAX
    transactions_count: int = BLOCK_TRANSACTIONS_MAX_COUNT


PROTOCOL_LIMITS = ExecutionLimits()


@dataclass(frozen=True, slots=True)
class BlockResult:
    """A block's effect; receipts follow executed transactions.

    `left_out` have no receipt: `faulty` broke the interpreter (`fault`: the first's error), others did not fit; empty
    for a valid foreign block.
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
