"""What proves a receipt to a client that trusts no node. Must never leave a gap between transaction and proof.

A header is final if its child has the next round and is certified; the certificate of a child stands in the
grandchild's header. So the proof for a block deep in the chain is made from the blocks above it, and only the newest
one, and the boundaries of epochs, need the proofs that the node keeps. Headers in between are handed over, so the
client can follow the parent ids.
"""

from __future__ import annotations

from collections.abc import Sequence

from consensus.block import Block, EpochProof, FinalityProof, Receipt
from consensus.errors import BlockRobotError
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.merkle import merkle_proof
from node.api.documents import Finality, TransactionEvidence, finality_document
from node.api.services import LedgerSnapshot, TransactionPlace

_HEADERS_MAX_COUNT = 2 * UNFINALIZED_BLOCKS_MAX_COUNT


def _proof_from_blocks(block: Block, snapshot: LedgerSnapshot) -> FinalityProof | None:
    """Return the proof of `block`: a boundary's own, or one out of the two blocks above it, or None if they make none."""
    header = block.header
    if header.is_boundary:
        data = snapshot.epoch_proof(header.epoch + 1)
        return None if data is None else decode(data, EpochProof).finality
    child, grandchild = snapshot.block(header.height + 1), snapshot.block(header.height + 2)
    if child is None or grandchild is None:
        return None
    child_header, qc = child.header, grandchild.header.qc
    if child_header.round != header.round + 1 or qc.block_id != child.block_id:
        return None
    if child_header.epoch != header.epoch or qc.epoch != header.epoch:
        return None
    return FinalityProof(header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=qc)


def _climb(snapshot: LedgerSnapshot, block: Block) -> tuple[list[bytes], Finality]:
    """Return the headers from `block` up to the first that can be proved final, and that proof."""
    headers: list[bytes] = []
    current: Block | None = block
    while current is not None and len(headers) < _HEADERS_MAX_COUNT:
        headers.append(current.header_bytes)
        height = current.header.height
        proof = snapshot.finality if height == snapshot.header.height else _proof_from_blocks(current, snapshot)
        document = finality_document(proof)
        if document is not None:
            return headers, document
        current = snapshot.block(height + 1)
    raise BlockRobotError("NOT_FOUND", "This node no longer holds what proves the transaction final.")


def build_evidence(
    snapshot: LedgerSnapshot, block: Block, receipts: Sequence[Receipt], place: TransactionPlace
) -> TransactionEvidence:
    """Return the evidence for the transaction at `place` of `block`. Raises NOT_FOUND if blocks above were pruned."""
    headers, finality = _climb(snapshot, block)
    receipt_leaves = [tagged_hash("blockrobot/receipt-leaf", encode(receipt)) for receipt in receipts]
    transaction_leaves = [tagged_hash("blockrobot/tx-leaf", receipt.txid) for receipt in receipts]
    return TransactionEvidence(
        headers=[header.hex() for header in headers],
        finality=finality,
        receipt=encode(receipts[place.index]).hex(),
        count=len(receipts),
        receipt_path=[node.hex() for node in merkle_proof(receipt_leaves, place.index)],
        transaction_path=[node.hex() for node in merkle_proof(transaction_leaves, place.index)],
    )
