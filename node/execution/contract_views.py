"""The read-only entries of a chain's contracts, run on one version of its state."""

from __future__ import annotations

from typing import Any

from consensus.chain.genesis import Genesis
from consensus.primitives.encoding import encode_value
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from contracts.lifecycle.catalogue import Catalogue
from contracts.lifecycle.registry import require_contracts
from contracts.state.view import StateReader


class ContractViews:
    """Runs views with the contracts that the state names."""

    def __init__(self, genesis: Genesis) -> None:
        """Raises GENESIS_INVALID if the chain's first contracts are not the ones that ship here."""
        require_contracts(genesis)
        self._chain_id = genesis.chain_id
        self._catalogue = Catalogue()

    def load(self, state: StateReader) -> None:
        """Read and compile the contracts that answer on this state."""
        self._catalogue.active(state)

    def run(
        self, state: StateReader, height: int, time_ms: int, contract: str, view: str, arguments: list[Any]
    ) -> bytes:
        """Return the encoded result of a view; height and time (ms) are those of the state's newest block.

        Raises TRANSACTION_CONTRACT_UNKNOWN for an unknown contract or view, CONTRACT_DISABLED, CALL_REFUSED if the
        contract refuses.
        """
        context = BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)
        return encode_value(run_view(state, self._catalogue.active(state), context, contract, view, arguments))
