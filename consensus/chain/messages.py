"""Messages between producers; each signature covers chain, epoch and round under its own tag."""

from __future__ import annotations

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.primitives.encoding import EXACT_INTEGER_END, Wire, u32, u64
from consensus.primitives.keys import PrivateKey, verify

VOTE_TAG = "blockrobot/vote"
TIMEOUT_TAG = "blockrobot/timeout"
PROPOSAL_TAG = "blockrobot/proposal"

MESSAGE_PROPOSAL = "proposal"
MESSAGE_VOTE = "vote"
MESSAGE_TIMEOUT = "timeout"

SIGNING = "signing"
ASKING = "asking"
LOCKED_OUT = "locked-out"


class Vote(Wire, frozen=True):
    """A producer's vote for a block."""

    epoch: int
    round: int
    block_id: bytes
    index: int
    signature: bytes


class Timeout(Wire, frozen=True):
    """A producer's timeout, with its highest QC and entering TC."""

    epoch: int
    round: int
    index: int
    signature: bytes
    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


class Proposal(Wire, frozen=True):
    """A leader's block; the header carries QC and, after a lost round, TC."""

    block: Block


class CertificateNotice(Wire, frozen=True):
    """Answer to a stale timeout: highest QC and entering TC."""

    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


class SignedMessage(Wire, frozen=True):
    """A producer's signed message; a timeout names no block, others no QC round."""

    kind: str
    epoch: int
    round: int
    block_id: bytes
    qc_round: int
    signature: bytes


class LastSignedRequest(Wire, frozen=True):
    """A restarted producer's request for its last messages (R33); `asked_at_ms` is echoed."""

    epoch: int
    asked_at_ms: int


class LastSignedResponse(Wire, frozen=True):
    """The asker's message as known here, and the sender's last signed round.

    `signing_state` is SIGNING, ASKING or LOCKED_OUT; `qc` and `entered_by` prove the sender's round.
    """

    epoch: int
    asked_at_ms: int
    signing_state: str
    signed_round: int
    message: SignedMessage | None
    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


def vote_parts(chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> tuple[bytes, ...]:
    return (chain_id, u32(epoch), u64(round_number), block_id)


def timeout_parts(chain_id: bytes, epoch: int, round_number: int, qc_round: int) -> tuple[bytes, ...]:
    return (chain_id, u32(epoch), u64(round_number), u64(qc_round))


def sign_vote(key: PrivateKey, chain_id: bytes, epoch: int, round_number: int, block_id: bytes, index: int) -> Vote:
    """Sign a vote; the caller journals it before sending."""
    signature = key.sign_compact(VOTE_TAG, *vote_parts(chain_id, epoch, round_number, block_id))
    return Vote(epoch=epoch, round=round_number, block_id=block_id, index=index, signature=signature)


def is_valid_vote(vote: Vote, chain_id: bytes, public_key: bytes) -> bool:
    parts = vote_parts(chain_id, vote.epoch, vote.round, vote.block_id)
    return verify(public_key, VOTE_TAG, vote.signature, *parts)


def sign_timeout(
    key: PrivateKey,
    chain_id: bytes,
    round_number: int,
    index: int,
    qc: QuorumCertificate,
    entered_by: TimeoutCertificate | None,
    epoch: int,
) -> Timeout:
    parts = timeout_parts(chain_id, epoch, round_number, qc.round)
    signature = key.sign_compact(TIMEOUT_TAG, *parts)
    return Timeout(epoch=epoch, round=round_number, index=index, signature=signature, qc=qc, entered_by=entered_by)


def is_valid_timeout_signature(timeout: Timeout, chain_id: bytes, public_key: bytes) -> bool:
    parts = timeout_parts(chain_id, timeout.epoch, timeout.round, timeout.qc.round)
    return verify(public_key, TIMEOUT_TAG, timeout.signature, *parts)


def proposal_parts(chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> tuple[bytes, ...]:
    return (chain_id, u32(epoch), u64(round_number), block_id)


def sign_block(key: PrivateKey, chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> bytes:
    return key.sign_compact(PROPOSAL_TAG, *proposal_parts(chain_id, epoch, round_number, block_id))


def is_valid_block_signature(
    chain_id: bytes, epoch: int, round_number: int, block_id: bytes, signature: bytes, public_key: bytes
) -> bool:
    return verify(public_key, PROPOSAL_TAG, signature, *proposal_parts(chain_id, epoch, round_number, block_id))


def is_genuine(message: SignedMessage, chain_id: bytes, public_key: bytes) -> bool:
    """Check a message's signature; never raises for peer input."""
    if (
        not 0 <= message.epoch < 1 << 32
        or not 0 < message.round < EXACT_INTEGER_END
        or not 0 <= message.qc_round < EXACT_INTEGER_END
    ):
        return False
    if message.kind == MESSAGE_TIMEOUT:
        parts = timeout_parts(chain_id, message.epoch, message.round, message.qc_round)
        return verify(public_key, TIMEOUT_TAG, message.signature, *parts)
    if message.kind == MESSAGE_VOTE:
        return verify(
            public_key,
            VOTE_TAG,
            message.signature,
            *vote_parts(chain_id, message.epoch, message.round, message.block_id),
        )
    if message.kind == MESSAGE_PROPOSAL:
        parts = proposal_parts(chain_id, message.epoch, message.round, message.block_id)
        return verify(public_key, PROPOSAL_TAG, message.signature, *parts)
    return False
