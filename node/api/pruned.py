"""Answers to requests for pruned blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from consensus.errors import BlockRobotError
from node.api.services import LedgerSnapshot

PeersWithBlock = Callable[[int], Sequence[str]]
"""Returns the names of the peers that say they keep the body of the block of a height."""


def require_not_pruned(snapshot: LedgerSnapshot, height: int, peers_with_block: PeersWithBlock) -> None:
    """Raise BLOCK_PRUNED, naming keepers, if this block's body is not here."""
    earliest = snapshot.earliest_height
    if height < earliest:
        names = peers_with_block(height)
        who = f"{', '.join(names)} {'keep' if len(names) > 1 else 'keeps'} it" if names else "No peer says to keep it"
        raise BlockRobotError(
            "BLOCK_PRUNED", f"The body of block {height} was pruned; this node has them from {earliest} on. {who}."
        )
