"""The genesis block, made from the genesis file alone."""

from __future__ import annotations

from consensus.chain.block import Receipts
from consensus.chain.genesis import Genesis
from consensus.primitives.encoding import encode
from contracts.execution.genesis import open_genesis
from node.storage.ledger_store import FinalizedBlock


def genesis_block(genesis: Genesis) -> FinalizedBlock:
    """Return the genesis block with its state, ready to store. Raises GENESIS_INVALID."""
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
