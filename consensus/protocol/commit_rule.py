"""Commit rule and finality proofs (R8); a boundary ends the epoch, dropping closing blocks (R22)."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import FinalityProof
from consensus.protocol.block_tree import BlockNode, BlockTree, TwoChain


@dataclass(frozen=True, slots=True)
class Commit:
    """The new finalized head and proof; `ends_epoch`: it is a boundary."""

    head: BlockNode
    proof: FinalityProof
    ends_epoch: bool


def have_contradiction(tree: BlockTree, chains: list[TwoChain]) -> bool:
    ids = {node.block_id for node in tree.branch(chains[-1].final.block_id) or []}
    return any(chain.final.block_id not in ids for chain in chains)


def choose_commit(tree: BlockTree, chains: list[TwoChain]) -> Commit:
    """Return the newest chain's commit; `chains` non-empty, oldest first, consistent."""
    newest = chains[-1]
    path = tree.branch(newest.final.block_id) or []
    for place, node in enumerate(path):
        if node.header.is_boundary:
            return _end_epoch(path[place:], chains)
    return Commit(head=newest.final, proof=_prove([newest.final], newest), ends_epoch=False)


def _end_epoch(closing: list[BlockNode], chains: list[TwoChain]) -> Commit:
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
