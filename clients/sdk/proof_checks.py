"""What the client believes, and why: the genesis file, and whatever proofs lead to from there.

The pin holds
that header and the steps through the epochs, so that the next run need not ask for them again (`clients/sdk/trust_pin.py`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from clients.sdk.chain.receipts import FinalReceipt, final_receipt
from clients.sdk.node_answers import (
    EpochsAnswer,
    EvidenceDocument,
    FinalityDocument,
    ProofsAnswer,
    read_finality,
    read_hex,
)
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
    """Proved values by flat key (None where the key is proved absent), and the block whose state they are of.

    `answer` is what proved them, for who wants to hand the proofs on.
    """

    height: int
    timestamp_ms: int
    values: dict[bytes, Any]
    answer: ProofsAnswer | None = field(default=None, repr=False, compare=False)


class ProofVerifier:
    """Checks answers with a light client, and follows evidence down from final headers."""

    def __init__(self, genesis: Genesis, light_client: LightClient) -> None:
        self._light_client = light_client
        self._genesis = genesis
        self._chain_id = genesis.chain_id
        self._genesis_header = genesis.block().header

    @property
    def epoch(self) -> int:
        """The number of the newest epoch that was entered."""
        return self._light_client.epoch.number

    def follow(self, answer: EpochsAnswer) -> bool:
        """Follow the chain through the epochs of an answer; tell whether that led further.

        Raises PROOF_INVALID, CERTIFICATE_INVALID, PROOF_OTHER_EPOCH, ENCODING_*.
        """
        before = self.epoch
        for proof in answer.epochs:
            self._light_client.advance(decode(read_hex(proof), EpochProof))
        return self.epoch > before

    def _final(self, proof: FinalityProof) -> Header:
        """Return the header that a proof of an epoch already entered shows to be final. Raises PROOF_OTHER_EPOCH."""
        epoch, steps = decode(proof.header_bytes, Header).epoch, self._light_client.epochs
        if not 0 <= epoch <= len(steps):
            raise BlockRobotError("PROOF_OTHER_EPOCH", f"The proof is of epoch {epoch}.")
        schedule, first_id = self._genesis.schedule, self._genesis.block_id
        if epoch:
            step = steps[epoch - 1]
            schedule, first_id = Schedule.of(step.epoch), sha256(step.finality.header_bytes)
        return verify_finality(proof, schedule, self._chain_id, first_id)

    def finality(self, document: FinalityDocument | None) -> Header:
        """Check a finality proof (None stands for genesis) and pin its header.

        Raises CERTIFICATE_INVALID, PROOF_INVALID or ENCODING_*; PROOF_STALE if the header is older than the pinned one.
        """
        if document is not None:
            return self._light_client.accept(read_finality(document))
        if self._light_client.header.height > 0:
            raise BlockRobotError("PROOF_STALE", "The node knows of nothing final but genesis.")
        return self._genesis_header

    def values(self, answer: ProofsAnswer, keys: Sequence[bytes]) -> ProvedState:
        """Check an answer that proves exactly these flat keys, in order, and return the decoded values.

        Raises PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*, PROOF_STALE.
        """
        header = self.finality(answer.finality)
        if [read_hex(proof.key) for proof in answer.proofs] != list(keys):
            raise BlockRobotError("PROOF_INVALID", "The answer is for other keys than were asked for.")
        values: dict[bytes, Any] = {}
        for key, document in zip(keys, answer.proofs, strict=True):
            value = None if document.value is None else read_hex(document.value)
            verify_proof(header.state_root, key, value, decode(read_hex(document.proof), Proof))
            values[key] = None if value is None else decode_value(value)
        return ProvedState(header.height, header.timestamp_ms, values, answer)

    def receipt(self, evidence: EvidenceDocument, txid: bytes, index: int) -> FinalReceipt:
        """Check that the receipt of this transaction stands in a final block. Raises PROOF_INVALID and the like."""
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

    def _follow(self, evidence: EvidenceDocument) -> tuple[Header, bytes]:
        """Follow the headers from the transaction's block to a final one; return the first header and its id.

        A proof older than the pin is as good as a newer one: what was final stays final.
        """
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
