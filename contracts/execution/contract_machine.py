"""One chain's contracts, selected by parent state and due changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from consensus.chain.genesis import Genesis
from consensus.chain.transaction import Transaction
from contracts.execution.call_host import CallHost
from contracts.execution.executor import execute_block
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext, BlockResult, ExecutionLimits, note_nothing
from contracts.lifecycle.applying_changes import apply_due_changes
from contracts.lifecycle.catalogue import Catalogue
from contracts.lifecycle.registry import require_contracts
from contracts.state.view import StateView


class ContractMachine:
    """Executes one chain's blocks (`chain_id`, 32 bytes)."""

    def __init__(self, chain_id: bytes, catalogue: Catalogue, limits: ExecutionLimits = PROTOCOL_LIMITS) -> None:
        self._chain_id = chain_id
        self._catalogue = catalogue
        self._limits = limits

    @classmethod
    def of_genesis(cls, genesis: Genesis) -> ContractMachine:
        """Raises GENESIS_INVALID for unshipped contracts."""
        require_contracts(genesis)
        return cls(genesis.chain_id, Catalogue())

    def _context(self, height: int, time_ms: int) -> BlockContext:
        return BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = note_nothing,
    ) -> tuple[BlockResult, list[bytes]]:
        """Execute what fits, in order; return the result and permanently unusable txids.

        `gives_up_change` fails the due version (R42). Raises ExecutionFault if that version breaks the interpreter.
        """
        context, host = self._context(height, time_ms), CallHost(parent)
        contracts = apply_due_changes(host, self._catalogue, context, gives_up=gives_up_change, note=note)
        limits = self._limits
        result = execute_block(
            parent, contracts, context, transactions, limits=limits, leader=True, host=host, note=note
        )
        return result, list(result.faulty)

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        effort: int = 0,
        note: Callable[[int], None] = note_nothing,
    ) -> BlockResult:
        """Execute exactly these. Raises BLOCK_INVALID if too many, ExecutionFault (no verdict, no vote).

        `effort` is unused here.
        """
        del effort
        context, host = self._context(height, time_ms), CallHost(parent)
        contracts = apply_due_changes(host, self._catalogue, context, gives_up=gives_up_change, note=note)
        return execute_block(parent, contracts, context, transactions, limits=self._limits, host=host, note=note)
