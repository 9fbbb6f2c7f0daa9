"""What a node that pruned old blocks answers when it is asked for one. Must never say "not found" of what was there."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from node.api.services import LedgerSnapshot


def require_kept(snapshot: LedgerSnapshot, height: int) -> None:
    """Raise BLOCK_PRUNED if the body of the finalized block of this height is no longer here."""
    earliest = snapshot.earliest_height
    if height < earliest:
        raise BlockRobotError(
            "BLOCK_PRUNED", f"The body of block {height} was pruned; this node has them from {earliest} on."
        )
