"""The contracts of one chain, as the node's parts use them. Must never keep anything from one block to the next."""

from __future__ import annotations

from typing import Any

from consensus.block import Receipts
from consensus.genesis import Genesis
from consensus.primitives.encoding import encode, encode_value
from contracts.execution.catalogue import Catalogue
from contracts.execution.genesis import open_genesis
from contracts.execution.registry import require_contracts
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from node.api.services import LedgerSnapshot
from node.storage.ledger_store import FinalizedBlock


def genesis_block(genesis: Genesis) -> FinalizedBlock:
    """Return the genesis block with its state, ready to be stored. Raises GENESIS_INVALID."""
    state = open_genesis(genesis)
    block = genesis.block()
    return FinalizedBlock(
        height=0,
        block_id=block.block_id,
        block_bytes=encode(block),
        receipts_bytes=encode(Receipts(receipts=())),
        timestamp_ms=block.header.timestamp_ms,
        state_root=state.state_root,
        state_writes=state.writes,
        page_writes=state.pages,
    )


class ViewRunner:
    """Runs the read-only entries of the chain's contracts for the HTTP interface."""

    def __init__(self, genesis: Genesis) -> None:
        """Raises GENESIS_INVALID if the chain's first contracts are not the ones that ship here."""
        self._chain_id = genesis.chain_id
        require_contracts(genesis)
        self._catalogue = Catalogue()

    def run_view(self, snapshot: LedgerSnapshot, contract: str, view: str, arguments: list[Any]) -> bytes:
        """Return the encoded result of a view on this snapshot.

        Raises TRANSACTION_CONTRACT_UNKNOWN for an unknown contract or view, REQUEST_INVALID if the contract refuses.
        """
        header = snapshot.header
        context = BlockContext(chain_id=self._chain_id, height=header.height, time_ms=header.timestamp_ms)
        return encode_value(run_view(snapshot, self._catalogue.active(snapshot), context, contract, view, arguments))
