"""Equivocation evidence: two ids signed by one producer in one round (R12, R13), identically encoded by everyone (R30)."""

from __future__ import annotations

from consensus.chain.messages import MESSAGE_PROPOSAL, MESSAGE_VOTE, PROPOSAL_TAG, VOTE_TAG, proposal_parts, vote_parts
from consensus.chain.signature_cache import SignatureCheck
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END, Wire
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.primitives.keys import verify

_TAGS = {MESSAGE_PROPOSAL: PROPOSAL_TAG, MESSAGE_VOTE: VOTE_TAG}
_PARTS = {MESSAGE_PROPOSAL: proposal_parts, MESSAGE_VOTE: vote_parts}
_EPOCH_END = 1 << 32


class Evidence(Wire, frozen=True):
    """Two signatures (64 bytes) of `producer` (33-byte key) in one round, `first_id` < `second_id`."""

    kind: str
    epoch: int
    round: int
    producer: bytes
    first_id: bytes
    first_signature: bytes
    second_id: bytes
    second_signature: bytes


def make_evidence(
    kind: str, epoch: int, round_number: int, producer: bytes, one: tuple[bytes, bytes], other: tuple[bytes, bytes]
) -> Evidence:
    (first_id, first_signature), (second_id, second_signature) = sorted((one, other))
    return Evidence(
        kind=kind,
        epoch=epoch,
        round=round_number,
        producer=producer,
        first_id=first_id,
        first_signature=first_signature,
        second_id=second_id,
        second_signature=second_signature,
    )


def is_valid_message_signature(
    kind: str,
    chain_id: bytes,
    epoch: int,
    round_number: int,
    block_id: bytes,
    *,
    producer: bytes,
    signature: bytes,
    check: SignatureCheck = verify,
) -> bool:
    """Return whether `producer` signed this proposal or vote; never raises for known kinds."""
    if len(block_id) != HASH_SIZE_BYTES or not 0 < round_number < EXACT_INTEGER_END or not 0 <= epoch < _EPOCH_END:
        return False
    return check(producer, _TAGS[kind], signature, *_PARTS[kind](chain_id, epoch, round_number, block_id))


def verify_evidence(evidence: Evidence, chain_id: bytes, check: SignatureCheck = verify) -> None:
    """Check that both signatures are genuine and contradict. Raises EVIDENCE_INVALID."""
    if evidence.kind not in _TAGS:
        raise BlockRobotError("EVIDENCE_INVALID", f"There is no evidence of kind {evidence.kind!r}.")
    if not evidence.first_id < evidence.second_id:
        raise BlockRobotError("EVIDENCE_INVALID", "The two ids are equal or not in order.")
    signed = ((evidence.first_id, evidence.first_signature), (evidence.second_id, evidence.second_signature))
    for block_id, signature in signed:
        if not is_valid_message_signature(
            evidence.kind,
            chain_id,
            evidence.epoch,
            evidence.round,
            block_id,
            producer=evidence.producer,
            signature=signature,
            check=check,
        ):
            raise BlockRobotError("EVIDENCE_INVALID", "One of the signatures is not the accused producer's.")
