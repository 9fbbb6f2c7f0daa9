"""What executes blocks and views: in the node, in a worker, or for a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from consensus.chain.block import Block, Header, Receipt
from consensus.chain.transaction import Transaction
from contracts.execution.results import ExpectedBlock
from contracts.state.view import StateView
from node.limits.token_buckets import OWN, Source
from node.storage.ledger_view import LedgerView


@dataclass(frozen=True, slots=True)
class CheckedBlock:
    """A block proven final, with its decoded parts."""

    block: Block
    block_id: bytes
    header: Header
    transactions: tuple[Transaction, ...]


class BlockExecutionResult(Protocol):
    """A block's execution result. `left_out` are the txids without a receipt."""

    @property
    def receipts(self) -> tuple[Receipt, ...]: ...

    @property
    def writes(self) -> Mapping[bytes, bytes | None]: ...

    @property
    def page_writes(self) -> Mapping[bytes, bytes | None]: ...

    @property
    def state_root(self) -> bytes: ...

    @property
    def gas_used(self) -> int: ...

    @property
    def left_out(self) -> tuple[bytes, ...]: ...


class Machine(Protocol):
    """Runs contracts: a pure function of parent state, height, time and transactions."""

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
    ) -> tuple[BlockExecutionResult, list[bytes]]:
        """Execute what fits into a block, in order; return it and failed txids. Raises ExecutionFault."""
        ...

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        effort: int = 0,
    ) -> BlockExecutionResult:
        """Execute exactly these; `effort` allows more memory and time. Raises BLOCK_INVALID, ExecutionFault."""
        ...


@runtime_checkable
class RemoteMachine(Machine, Protocol):
    """A machine that is slow to reach: it takes several blocks at once."""

    def verify_ahead(self, parent: StateView, blocks: Sequence[ExpectedBlock]) -> Sequence[BlockExecutionResult]:
        """Return what `verify` gives for the first of consecutive blocks, maybe none."""
        ...


class ViewRunner(Protocol):
    """Runs the read-only entries of contracts."""

    async def run_view(
        self, snapshot: LedgerView, contract: str, view: str, arguments: list[Any], source: Source = OWN
    ) -> bytes:
        """Return a view's encoded result; the snapshot stays open until then.

        Raises TRANSACTION_CONTRACT_UNKNOWN, CONTRACT_DISABLED, CALL_REFUSED, RATE_LIMITED (this source), VIEWS_BUSY
        (all), CONTRACT_WORKER_FAILED.
        """
        ...
