"""Runs the read-only views of a chain's contracts on one state version."""

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
        """Raises GENESIS_INVALID if the first contracts differ from those shipped here."""
        require_contracts(genesis)
        self._chain_id = genesis.chain_id
        self._catalogue = Catalogue()

    def load(self, state: StateReader) -> None:
        self._catalogue.active(state)

    def run(
        self, state: StateReader, height: int, time_ms: int, contract: str, view: str, arguments: list[Any]
    ) -> bytes:
        """Return a view's encoded result at height and time (ms).

        Raises TRANSACTION_CONTRACT_UNKNOWN (or unknown view), CONTRACT_DISABLED, CALL_REFUSED.
        """
        context = BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)
        return encode_value(run_view(state, self._catalogue.active(state), context, contract, view, arguments))
