"""Verification from genesis onwards; the pin is in `clients/sdk/trust_pin.py`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from clients.sdk.chain.receipts import FinalReceipt, final_receipt
from clients.sdk.node_answers import read_finality, read_hex
from consensus.api_documents import EpochsAnswer, Finality, ProofsAnswer, TransactionEvidence
from consensus.chain.block import EpochProof, FinalityProof, Header, Receipt
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient, verify_finality
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value, encode
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.merkle import verify_merkle_proof
from consensus.primitives.trie import Proof, verify_proof

HEADERS_MAX_COUNT = 256


@dataclass(frozen=True, slots=True)
class ProvedState:
    """Proved values by flat key (None: absent), their block, and the proving `answer`."""

    height: int
    timestamp_ms: int
    values: dict[bytes, Any]
    answer: ProofsAnswer | None = field(default=None, repr=False, compare=False)


class ProofVerifier:
    """Checks answers with a light client."""

    def __init__(self, genesis: Genesis, light_client: LightClient) -> None:
        self._light_client = light_client
        self._genesis = genesis
        self._chain_id = genesis.chain_id
        self._genesis_header = genesis.block().header

    @property
    def epoch(self) -> int:
        return self._light_client.epoch.number

    def follow(self, answer: EpochsAnswer) -> bool:
        """Follow epochs; return whether it advanced. Raises PROOF_INVALID, CERTIFICATE_INVALID, PROOF_OTHER_EPOCH,
        ENCODING_*.
        """
        before = self.epoch
        for proof in answer.epochs:
            self._light_client.advance(decode(read_hex(proof), EpochProof))
        return self.epoch > before

    def _final(self, proof: FinalityProof) -> Header:
        """Raises PROOF_OTHER_EPOCH."""
        epoch, steps = decode(proof.header_bytes, Header).epoch, self._light_client.epochs
        if not 0 <= epoch <= len(steps):
            raise BlockRobotError("PROOF_OTHER_EPOCH", f"The proof is of epoch {epoch}.")
        schedule, first_id = self._genesis.schedule, self._genesis.block_id
        if epoch:
            step = steps[epoch - 1]
            schedule, first_id = Schedule.of(step.epoch), sha256(step.finality.header_bytes)
        return verify_finality(proof, schedule, self._chain_id, first_id)

    def final_header(self, document: Finality | None) -> Header:
        """Of any epoch that was followed; pins nothing, so it may be older than another's. Raises as `finality`."""
        return self._genesis_header if document is None else self._final(read_finality(document))

    def finality(self, document: Finality | None) -> Header:
        """Check a finality proof (None: genesis), pin its header. Raises CERTIFICATE_INVALID, PROOF_INVALID,
        ENCODING_*, PROOF_STALE (older than pin).
        """
        if document is not None:
            return self._light_client.accept(read_finality(document))
        if self._light_client.header.height > 0:
            raise BlockRobotError("PROOF_STALE", "The node knows of nothing final but genesis.")
        return self._genesis_header

    def values(self, answer: ProofsAnswer, keys: Sequence[bytes]) -> ProvedState:
        """Proved for exactly these keys, in order. Raises PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*, PROOF_STALE."""
        header = self.finality(answer.finality)
        if [read_hex(proof.key) for proof in answer.proofs] != list(keys):
            raise BlockRobotError("PROOF_INVALID", "The answer is for other keys than were asked for.")
        values: dict[bytes, Any] = {}
        for key, document in zip(keys, answer.proofs, strict=True):
            value = None if document.value is None else read_hex(document.value)
            verify_proof(header.state_root, key, value, decode(read_hex(document.proof), Proof))
            values[key] = None if value is None else decode_value(value)
        return ProvedState(header.height, header.timestamp_ms, values, answer)

    def receipt(self, evidence: TransactionEvidence, txid: bytes, index: int) -> FinalReceipt:
        """In a final block. Raises PROOF_INVALID etc."""
        header, block_id = self._follow(evidence)
        receipt = decode(read_hex(evidence.receipt), Receipt)
        leaf = tagged_hash("blockrobot/receipt-leaf", encode(receipt))
        path = [read_hex(node) for node in evidence.receipt_path]
        if receipt.txid != txid or not verify_merkle_proof(header.receipts_root, leaf, index, evidence.count, path):
            raise BlockRobotError("PROOF_INVALID", "The receipt does not stand in the block that it is claimed for.")
        leaf = tagged_hash("blockrobot/tx-leaf", txid)
        path = [read_hex(node) for node in evidence.transaction_path]
        if not verify_merkle_proof(header.transactions_root, leaf, index, evidence.count, path):
            raise BlockRobotError("PROOF_INVALID", "The transaction does not stand in the block of its receipt.")
        return final_receipt(
            receipt,
            height=header.height,
            index=index,
            block_id=block_id,
            timestamp_ms=header.timestamp_ms,
            evidence=evidence,
        )

    def _follow(self, evidence: TransactionEvidence) -> tuple[Header, bytes]:
        """Headers up to a final one; proofs older than the pin are valid."""
        chain = [read_hex(header) for header in evidence.headers]
        if not 1 <= len(chain) <= HEADERS_MAX_COUNT:
            raise BlockRobotError("PROOF_INVALID", "The evidence has no headers or too many.")
        proof = read_finality(evidence.finality)
        if proof.header_bytes != chain[-1]:
            raise BlockRobotError("PROOF_INVALID", "The evidence proves another block final.")
        final = self._final(proof)
        if final.height >= self._light_client.header.height:
            self._light_client.accept(proof)
        for lower, upper in itertools.pairwise(chain):
            if decode(upper, Header).parent_id != sha256(lower):
                raise BlockRobotError("PROOF_INVALID", "The headers of the evidence do not follow each other.")
        return decode(chain[0], Header), sha256(chain[0])
