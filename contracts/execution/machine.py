"""The contracts of one chain, ready to build and to verify blocks.

Which contracts answer is said by the parent's state, and by what takes effect with the block itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from consensus.chain.genesis import Genesis
from consensus.chain.transaction import Transaction
from contracts.execution.call_host import CallHost
from contracts.execution.executor import execute_block
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext, BlockResult, ExecutionLimits, note_nothing
from contracts.lifecycle.catalogue import Catalogue
from contracts.lifecycle.opening import open_block
from contracts.lifecycle.registry import require_contracts
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
        """Execute what fits into a block, in order; return that and the txids that no block should ever hold.

        With `gives_up_change` the version of a contract that is due fails (R42). `note` hears of what comes next. Raises
        ExecutionFault if the interpreter fails on that version.
        """
        context, host = self._context(height, time_ms), CallHost(parent)
        contracts = open_block(host, self._catalogue, context, gives_up=gives_up_change, note=note)
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
        """Execute exactly these transactions. Raises BLOCK_INVALID if they do not fit into one block.

        Raises ExecutionFault if the interpreter fails: no verdict on the block, and no vote. `effort` says how much a
        machine of another process may use up; here it means nothing.
        """
        del effort
        context, host = self._context(height, time_ms), CallHost(parent)
        contracts = open_block(host, self._catalogue, context, gives_up=gives_up_change, note=note)
        return execute_block(parent, contracts, context, transactions, limits=self._limits, host=host, note=note)
