"""Builds evidence that proves a receipt without trusting a node.

Only the newest block and epoch boundaries need stored proofs; later headers prove the others.
"""

from __future__ import annotations

from consensus.api_documents import Finality, TransactionEvidence, finality_document
from consensus.chain.block import EpochProof, FinalityProof, Header
from consensus.errors import BlockRobotError
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.merkle import merkle_proof
from node.api.access.metering import Steps
from node.storage.ledger_view import LedgerView, TransactionPlace

_HEADERS_MAX_COUNT = 2 * UNFINALIZED_BLOCKS_MAX_COUNT


def _header(snapshot: LedgerView, height: int) -> tuple[bytes, Header] | None:
    data = snapshot.header_bytes(height)
    return None if data is None else (data, decode(data, Header))


def _proof_from_headers(snapshot: LedgerView, header_bytes: bytes, header: Header) -> FinalityProof | None:
    if header.is_boundary:
        data = snapshot.epoch_proof(header.epoch + 1)
        return None if data is None else decode(data, EpochProof).finality
    child, grandchild = _header(snapshot, header.height + 1), _header(snapshot, header.height + 2)
    if child is None or grandchild is None:
        return None
    (child_bytes, child_header), qc = child, grandchild[1].qc
    if child_header.round != header.round + 1 or qc.block_id != sha256(child_bytes):
        return None
    if child_header.epoch != header.epoch or qc.epoch != header.epoch:
        return None
    return FinalityProof(header_bytes=header_bytes, child_header_bytes=child_bytes, child_qc=qc)


def _climb(snapshot: LedgerView, height: int) -> Steps[tuple[list[bytes], Finality]]:
    headers: list[bytes] = []
    current = _header(snapshot, height)
    while current is not None and len(headers) < _HEADERS_MAX_COUNT:
        header_bytes, header = current
        headers.append(header_bytes)
        is_newest = header.height == snapshot.header.height
        proof = snapshot.finality if is_newest else _proof_from_headers(snapshot, header_bytes, header)
        document = finality_document(proof)
        if document is not None:
            return headers, document
        yield
        current = _header(snapshot, header.height + 1)
    raise BlockRobotError("NOT_FOUND", "This node no longer holds what proves the transaction final.")


def build_evidence(snapshot: LedgerView, place: TransactionPlace) -> Steps[TransactionEvidence]:
    """Raises NOT_FOUND if block or proof is missing."""
    headers, finality = yield from _climb(snapshot, place.height)
    receipts = snapshot.receipt_bytes(place.height)
    if receipts is None:
        raise BlockRobotError("NOT_FOUND", "The block of this transaction is no longer kept here.")
    yield
    receipt_leaves = [tagged_hash("blockrobot/receipt-leaf", receipt) for _, receipt in receipts]
    receipt_path = merkle_proof(receipt_leaves, place.index)
    yield
    transaction_leaves = [tagged_hash("blockrobot/tx-leaf", txid) for txid, _ in receipts]
    transaction_path = merkle_proof(transaction_leaves, place.index)
    yield
    return TransactionEvidence(
        headers=[header.hex() for header in headers],
        finality=finality,
        receipt=receipts[place.index][1].hex(),
        count=len(receipts),
        receipt_path=[node.hex() for node in receipt_path],
        transaction_path=[node.hex() for node in transaction_path],
    )
