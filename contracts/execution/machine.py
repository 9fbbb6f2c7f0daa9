"""The contracts of one chain, ready to build and to verify blocks. Must never keep anything from one block to the next.

Which contracts answer is said by the parent's state, and by what takes effect with the block itself.
"""

from __future__ import annotations

from collections.abc import Sequence

from consensus.genesis import Genesis
from consensus.transaction import Transaction
from contracts.execution.call_host import CallHost
from contracts.execution.catalogue import Catalogue
from contracts.execution.executor import execute_block
from contracts.execution.opening import open_block
from contracts.execution.registry import require_contracts
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext, BlockResult, ExecutionLimits
from contracts.state.view import StateView


class ContractMachine:
    """Executes blocks of one chain (`chain_id`, 32 bytes) with the contracts that the state names."""

    def __init__(self, chain_id: bytes, catalogue: Catalogue, limits: ExecutionLimits = PROTOCOL_LIMITS) -> None:
        self._chain_id = chain_id
        self._catalogue = catalogue
        self._limits = limits

    @classmethod
    def of_genesis(cls, genesis: Genesis) -> ContractMachine:
        """Return the machine of a chain. Raises GENESIS_INVALID if its first contracts are not the ones shipped here."""
        require_contracts(genesis)
        return cls(genesis.chain_id, Catalogue())

    def _context(self, height: int, time_ms: int) -> BlockContext:
        return BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)

    def _execute(
        self, parent: StateView, context: BlockContext, transactions: Sequence[Transaction], *, leader: bool
    ) -> BlockResult:
        host = CallHost(parent)
        contracts = open_block(host, self._catalogue, context)
        return execute_block(parent, contracts, context, transactions, limits=self._limits, leader=leader, host=host)

    def build(
        self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction]
    ) -> tuple[BlockResult, list[bytes]]:
        """Execute what fits into a block, in order; return that and the txids that no block should ever hold."""
        result = self._execute(parent, self._context(height, time_ms), transactions, leader=True)
        return result, list(result.faulty)

    def verify(self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction]) -> BlockResult:
        """Execute exactly these transactions. Raises BLOCK_INVALID if they do not fit into one block.

        Raises InternalFault if the interpreter fails on one: no verdict on the block, and no vote.
        """
        return self._execute(parent, self._context(height, time_ms), transactions, leader=False)
