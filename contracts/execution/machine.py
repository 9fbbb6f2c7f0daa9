"""The contracts of one chain, ready to build and to verify blocks. Must never keep anything from one block to the next."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.transaction import Transaction
from contracts.execution.executor import Contracts, execute_block
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext, BlockResult, ExecutionLimits
from contracts.state.view import StateView


class ContractMachine:
    """Executes blocks of one chain (`chain_id`, 32 bytes) with its contracts."""

    def __init__(self, chain_id: bytes, contracts: Contracts, limits: ExecutionLimits = PROTOCOL_LIMITS) -> None:
        self._chain_id = chain_id
        self._contracts = contracts
        self._limits = limits

    def _context(self, height: int, time_ms: int) -> BlockContext:
        return BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)

    def build(
        self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction]
    ) -> tuple[BlockResult, list[bytes]]:
        """Execute what fits into a block, in order; return that and the txids that no block should ever hold."""
        context = self._context(height, time_ms)
        result = execute_block(parent, self._contracts, context, transactions, limits=self._limits, leader=True)
        return result, list(result.faulty)

    def verify(self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction]) -> BlockResult:
        """Execute exactly these transactions. Raises BLOCK_INVALID if they do not fit into one block.

        Raises InternalFault if the interpreter fails on one: no verdict on the block, and no vote.
        """
        return execute_block(parent, self._contracts, self._context(height, time_ms), transactions, limits=self._limits)
