"""Proofs kept of the wallet's own transactions, valid after nodes drop the blocks.

Genesis file and pinned epochs suffice to check them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.node_answers import read_finality, read_hex
from clients.sdk.proof_checks import ProvedState
from consensus.api_documents import Finality, TransactionEvidence
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.block import Receipt
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.state.erasure import REQUEST, ErasureRow

KEPT_PROOFS_MAX_BYTES = 16 * 1024 * 1024
"""All kept proofs together; beyond it the oldest go."""
_NAME = "the wallet"


class KeptProof(doc.Document, frozen=True):
    """A transaction's wire, receipt proof and proof of custodians' erasure receipts."""

    transaction: str
    proof: doc.ReceiptProof
    state: doc.StateProofs | None = None


@dataclass(frozen=True, slots=True)
class CheckedProof:
    """A valid proof; `erasure` is the complete erasure's row, `proved_height` the last proving block."""

    transaction: Transaction
    receipt: Receipt
    height: int
    index: int
    time_ms: int
    proved_height: int
    erasure: ErasureRow | None


class ProofHolder(Protocol):
    """Where proofs are kept: a wallet file's content."""

    proofs: dict[bytes, bytes]
    proofs_dropped_count: int


def receipt_proof(receipt: FinalReceipt, evidence: TransactionEvidence) -> doc.ReceiptProof:
    return doc.ReceiptProof(
        headers=[read_hex(header).hex() for header in evidence.headers],
        finality=finality_bytes(evidence.finality).hex(),
        receipt=read_hex(evidence.receipt).hex(),
        index=receipt.index,
        count=evidence.count,
        receipt_path=[read_hex(node).hex() for node in evidence.receipt_path],
        transaction_path=[read_hex(node).hex() for node in evidence.transaction_path],
    )


def finality_bytes(document: Finality) -> bytes:
    return encode(read_finality(document))


def keep_receipt(holder: ProofHolder, receipt: FinalReceipt) -> None:
    if receipt.evidence is None or receipt.transaction is None:
        return
    kept = KeptProof(receipt.transaction.wire.hex(), receipt_proof(receipt, receipt.evidence))
    _put(holder, receipt.txid, kept)


def keep_erasure(holder: ProofHolder, erasure_id: bytes, state: ProvedState) -> None:
    """Keep a complete erasure's proof with its request's, once."""
    kept, key = read_kept(holder, erasure_id), REQUEST.key(erasure_id)
    if kept is None or kept.state is not None or state.answer is None or state.answer.finality is None:
        return
    (part,) = [each for each in state.answer.proofs if read_hex(each.key) == key]
    value = None if part.value is None else read_hex(part.value).hex()
    snapshot = doc.Snapshot(
        finality_bytes(state.answer.finality).hex(), [doc.KeyProof(key.hex(), value, read_hex(part.proof).hex())]
    )
    _put(holder, erasure_id, msgspec.structs.replace(kept, state=doc.StateProofs([snapshot])))


def _put(holder: ProofHolder, txid: bytes, kept: KeptProof) -> None:
    holder.proofs[txid] = msgspec.json.encode(kept)
    size = sum(map(len, holder.proofs.values()))
    while size > KEPT_PROOFS_MAX_BYTES:
        oldest = next(iter(holder.proofs))
        size -= len(holder.proofs.pop(oldest))
        holder.proofs_dropped_count += 1


def read_kept(holder: ProofHolder, txid: bytes) -> KeptProof | None:
    """Raises KEPT_PROOF_DAMAGED."""
    kept = holder.proofs.get(txid)
    return None if kept is None else _read(txid, kept)


def _read(txid: bytes, packed: bytes) -> KeptProof:
    try:
        return read_json_as(packed, KeptProof)
    except TextInvalidError:
        raise BlockRobotError("KEPT_PROOF_DAMAGED", f"The proof kept of {txid.hex()[:12]} cannot be read.") from None


def check_kept(chain: ProvedChain, chain_id: bytes, txid: bytes, kept: KeptProof) -> CheckedProof:
    """Offline. Raises KEPT_PROOF_DAMAGED."""
    try:
        return _check(chain, chain_id, txid, kept)
    except BlockRobotError as error:
        if error.code == "KEPT_PROOF_DAMAGED":
            raise
        detail = f"The proof kept of {txid.hex()[:12]} does not hold: {error.detail} ({error.code})"
        raise BlockRobotError("KEPT_PROOF_DAMAGED", detail) from None


def _check(chain: ProvedChain, chain_id: bytes, txid: bytes, kept: KeptProof) -> CheckedProof:
    transaction = decode_transaction(doc.read_bytes(_NAME, kept.transaction))
    transaction.verify_sender()
    proved = chain.receipt(_NAME, kept.proof)
    if transaction.body.chain_id != chain_id or not transaction.txid == proved.receipt.txid == txid:
        raise BlockRobotError("KEPT_PROOF_DAMAGED", f"The proof kept of {txid.hex()[:12]} is another transaction's.")
    erasure, proved_height = None, proved.height
    if kept.state is not None:
        receipt_row = chain.state(_NAME, kept.state).get(REQUEST.key(txid))
        erasure = None if receipt_row is None or receipt_row.value is None else REQUEST.convert(receipt_row.value)
        if receipt_row is None or erasure is None or erasure.status != "complete":
            raise BlockRobotError("KEPT_PROOF_DAMAGED", f"The erasure {txid.hex()[:12]} is not proved complete.")
        proved_height = receipt_row.height
    return CheckedProof(
        transaction, proved.receipt, proved.height, proved.index, proved.time_ms, proved_height, erasure
    )


def check_all(holder: ProofHolder, chain: ProvedChain, chain_id: bytes) -> Iterator[CheckedProof | BlockRobotError]:
    for txid in list(holder.proofs):
        try:
            kept = read_kept(holder, txid)
            if kept is not None:
                yield check_kept(chain, chain_id, txid, kept)
        except BlockRobotError as error:
            yield error


def kept_of(
    proofs: Mapping[bytes, bytes], chain: ProvedChain, chain_id: bytes, contract: str
) -> Sequence[tuple[bytes, KeptProof]]:
    found = []
    for txid, packed in proofs.items():
        try:
            kept = _read(txid, packed)
            if decode_transaction(doc.read_bytes(_NAME, kept.transaction)).body.contract == contract:
                check_kept(chain, chain_id, txid, kept)
                found.append((txid, kept))
        except BlockRobotError:
            continue
    return found
