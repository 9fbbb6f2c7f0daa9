"""Runs of finalized blocks within one epoch, with a proof for the last one.

Signatures and transactions, not covered by ids, are checked here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from consensus.chain.block import Block, EpochProof, FinalityProof
from consensus.chain.block_rules import check_body, check_header_form
from consensus.chain.light_client import verify_finality
from consensus.chain.messages import PROPOSAL_TAG, proposal_parts
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.keys import verify
from node.consensus.epoch_change import EpochStart
from node.execution.execution_machines import CheckedBlock
from node.p2p.wire import BlockBatch
from node.storage.ledger_store import LedgerSnapshot

RANGE_MAX_COUNT = 256
RANGE_MAX_BYTES = 4 * 1024 * 1024
PROOF_SEARCH_MAX_COUNT = 192

# Reading


def proof_from_blocks(block: Block, child: Block | None, grandchild: Block | None) -> FinalityProof | None:
    """Return a stored block's two-chain proof from the blocks above, or None."""
    if child is None or grandchild is None:
        return None
    header, child_header, qc = block.header, child.header, grandchild.header.qc
    if child_header.round != header.round + 1 or child_header.epoch != header.epoch:
        return None
    if qc.block_id != child.block_id or qc.epoch != header.epoch:
        return None
    return FinalityProof(header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=qc)


def finality_of(snapshot: LedgerSnapshot, height: int) -> FinalityProof | None:
    position = snapshot.position
    if position is not None and position.height == height:
        return decode(snapshot.finality, FinalityProof) if snapshot.finality else None
    found = [snapshot.block(height + offset) for offset in range(3)]
    block, child, grandchild = (None if data is None else decode(data, Block) for data in found)
    if block is None:
        return None
    return boundary_proof(snapshot, block) or proof_from_blocks(block, child, grandchild)


def boundary_proof(snapshot: LedgerSnapshot, block: Block) -> FinalityProof | None:
    header = block.header
    if header.next_schedule_hash is None:
        return None
    data = snapshot.epoch_proof(header.epoch + 1)
    return None if data is None else decode(data, EpochProof).finality


def read_range(snapshot: LedgerSnapshot, from_height: int, count: int) -> BlockBatch:
    """Return about `count` stored blocks of one epoch, ending provably; none if pruned."""
    blocks: list[bytes] = []
    size, proof, wanted = 0, None, min(max(1, count), RANGE_MAX_COUNT)
    for height, data in snapshot.iter_blocks(from_height, wanted + PROOF_SEARCH_MAX_COUNT):
        size += len(data)
        if height != from_height + len(blocks) or (blocks and size > RANGE_MAX_BYTES):
            break
        blocks.append(data)
        if decode(data, Block).header.next_schedule_hash is not None:
            break
        if len(blocks) >= wanted:
            proof = finality_of(snapshot, height)
            if proof is not None:
                break
    while blocks and proof is None:
        proof = finality_of(snapshot, from_height + len(blocks) - 1)
        if proof is None:
            blocks.pop()
    return BlockBatch(blocks=tuple(blocks), proof=proof, earliest_height=snapshot.earliest_height)


# Checking


@dataclass(frozen=True, slots=True)
class CheckedRange:
    """A run of blocks, proven final, and its peer."""

    peer: str
    blocks: Sequence[CheckedBlock]
    proof: FinalityProof

    @property
    def last(self) -> CheckedBlock:
        return self.blocks[-1]

    @property
    def ends_epoch(self) -> bool:
        return self.last.header.next_schedule_hash is not None


def decode_range(batch: BlockBatch) -> list[Block]:
    return [decode(data, Block) for data in batch.blocks]


def check_range(
    blocks: Sequence[Block],
    proof: FinalityProof,
    *,
    from_height: int,
    start: EpochStart,
    chain_id: bytes,
    read: Callable[[bytes], Transaction],
) -> list[CheckedBlock]:
    """Check that blocks are consecutive in one epoch and the last is final.

    Raises BLOCK_INVALID, PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*, SIGNATURE_*.
    """
    verify_finality(proof, start.schedule, chain_id, start.round_zero_id)
    if proof.header_bytes != blocks[-1].header_bytes:
        raise BlockRobotError("CERTIFICATE_INVALID", "The proof is not for the last block of the run.")
    checked: list[CheckedBlock] = []
    parent_id: bytes | None = None
    for height, block in enumerate(blocks, start=from_height):
        header, block_id = block.header, block.block_id
        if header.height != height or (parent_id is not None and header.parent_id != parent_id):
            raise BlockRobotError("BLOCK_INVALID", "The peer's blocks do not follow one another.")
        if header.is_closing or (header.next_schedule_hash is not None and block is not blocks[-1]):
            raise BlockRobotError("BLOCK_INVALID", "The peer's blocks go on behind a boundary.")
        check_header_form(header, chain_id, start.schedule)
        parts = proposal_parts(chain_id, header.epoch, header.round, block_id)
        if not verify(start.schedule.producers[header.producer], PROPOSAL_TAG, block.signature, *parts):
            raise BlockRobotError("BLOCK_INVALID", "A block is not signed by its producer.")
        check_body(block, header)
        checked.append(CheckedBlock(block, block_id, header, tuple(read(wire) for wire in block.transactions)))
        parent_id = block_id
    return checked
