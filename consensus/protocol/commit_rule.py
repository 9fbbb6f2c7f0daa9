"""Which blocks are final, and the proof of it. Must never finalize a block that only closes its epoch.

By R8 a certified pair of consecutive rounds makes its first block final, with all ancestors. If a boundary is among them
the epoch ends there (R22): the closing blocks above it are dropped, and the proof leads from the boundary to the pair.
"""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import FinalityProof
from consensus.protocol.block_tree import BlockNode, BlockTree, TwoChain


@dataclass(frozen=True, slots=True)
class Commit:
    """The new finalized head and its proof. `ends_epoch`: the head is a boundary."""

    head: BlockNode
    proof: FinalityProof
    ends_epoch: bool


def have_contradiction(tree: BlockTree, chains: list[TwoChain]) -> bool:
    """Tell whether two of the final blocks exclude each other (R18). `chains` is not empty, oldest first."""
    ids = {node.block_id for node in tree.branch(chains[-1].final.block_id) or []}
    return any(chain.final.block_id not in ids for chain in chains)


def choose_commit(tree: BlockTree, chains: list[TwoChain]) -> Commit:
    """Return what the newest of these chains makes final. `chains` is not empty, oldest first, without contradiction."""
    newest = chains[-1]
    path = tree.branch(newest.final.block_id) or []
    for place, node in enumerate(path):
        if node.header.is_boundary:
            return _end_epoch(path[place:], chains)
    return Commit(head=newest.final, proof=_prove([newest.final], newest), ends_epoch=False)


def _end_epoch(closing: list[BlockNode], chains: list[TwoChain]) -> Commit:
    """`closing` leads from the boundary to the final block of the newest chain: the oldest chain among them will do."""
    chain = next(chain for chain in chains if chain.final in closing)
    between = closing[: closing.index(chain.final) + 1]
    return Commit(head=closing[0], proof=_prove(between, chain), ends_epoch=True)


def _prove(path: list[BlockNode], chain: TwoChain) -> FinalityProof:
    return FinalityProof(
        header_bytes=path[0].block.header_bytes,
        child_header_bytes=chain.child.block.header_bytes,
        child_qc=chain.child_qc,
        through=tuple(node.block.header_bytes for node in path[1:]),
    )
