"""What producers say to each other about rounds, and the exact bytes that they sign. Must never be signed unjournalled.

Every signed string names chain, epoch and round under its own domain tag, so that a vote can pass neither for a
timeout nor for a vote on another chain or in another epoch.
"""

from __future__ import annotations

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.primitives.encoding import Wire, u32, u64
from consensus.primitives.keys import PrivateKey, verify

VOTE_TAG = "blockrobot/vote"
TIMEOUT_TAG = "blockrobot/timeout"
PROPOSAL_TAG = "blockrobot/proposal"

WORD_PROPOSAL = "proposal"
WORD_VOTE = "vote"
WORD_TIMEOUT = "timeout"

SPEAKING = "speaking"
ASKING = "asking"
SILENT = "silent"


class Vote(Wire, frozen=True):
    """One producer's vote for one block of one round."""

    epoch: int
    round: int
    block_id: bytes
    index: int
    signature: bytes


class Timeout(Wire, frozen=True):
    """One producer gave a round up: with the highest QC it knows and the TC by which it entered the round."""

    epoch: int
    round: int
    index: int
    signature: bytes
    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


class Proposal(Wire, frozen=True):
    """A leader's block for its round. The block's header carries the QC and, after a lost round, the TC."""

    block: Block


class CertificateNotice(Wire, frozen=True):
    """The answer to a stale timeout: the highest QC and the TC by which the sender entered its round."""

    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


class Word(Wire, frozen=True):
    """Any signed word of a producer, cut down to what was signed. A timeout names no block, the others no QC round."""

    kind: str
    epoch: int
    round: int
    block_id: bytes
    qc_round: int
    signature: bytes


class WordsRequest(Wire, frozen=True):
    """A producer that just started asks what was last heard of it (R33). `asked_at_ms` comes back in the answer."""

    epoch: int
    asked_at_ms: int


class WordsAnswer(Wire, frozen=True):
    """What the sender holds of the asker (`word`), and of itself: whether it speaks, the last round that it signed in.

    `speech` is SPEAKING, ASKING or SILENT. `qc` and `entered_by` prove that the sender may have been in that round.
    """

    epoch: int
    asked_at_ms: int
    speech: str
    signed_round: int
    word: Word | None
    qc: QuorumCertificate
    entered_by: TimeoutCertificate | None


def vote_parts(chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> tuple[bytes, ...]:
    """Return the parts that a vote signs under VOTE_TAG."""
    return (chain_id, u32(epoch), u64(round_number), block_id)


def timeout_parts(chain_id: bytes, epoch: int, round_number: int, qc_round: int) -> tuple[bytes, ...]:
    """Return the parts that a timeout signs under TIMEOUT_TAG: (chain, epoch, round, qc_round)."""
    return (chain_id, u32(epoch), u64(round_number), u64(qc_round))


def sign_vote(key: PrivateKey, chain_id: bytes, epoch: int, round_number: int, block_id: bytes, index: int) -> Vote:
    """Sign a vote. The caller has journalled it, or journals it before sending."""
    signature = key.sign_compact(VOTE_TAG, *vote_parts(chain_id, epoch, round_number, block_id))
    return Vote(epoch=epoch, round=round_number, block_id=block_id, index=index, signature=signature)


def is_valid_vote(vote: Vote, chain_id: bytes, public_key: bytes) -> bool:
    """Tell whether the vote was signed by `public_key` (33 bytes)."""
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
    """Sign a timeout for `round_number`, naming the round of the highest known QC."""
    parts = timeout_parts(chain_id, epoch, round_number, qc.round)
    signature = key.sign_compact(TIMEOUT_TAG, *parts)
    return Timeout(epoch=epoch, round=round_number, index=index, signature=signature, qc=qc, entered_by=entered_by)


def is_valid_timeout_signature(timeout: Timeout, chain_id: bytes, public_key: bytes) -> bool:
    """Tell whether the timeout itself was signed by `public_key`; its certificates are checked apart."""
    parts = timeout_parts(chain_id, timeout.epoch, timeout.round, timeout.qc.round)
    return verify(public_key, TIMEOUT_TAG, timeout.signature, *parts)


def proposal_parts(chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> tuple[bytes, ...]:
    """Return the parts that a leader signs under PROPOSAL_TAG."""
    return (chain_id, u32(epoch), u64(round_number), block_id)


def sign_block(key: PrivateKey, chain_id: bytes, epoch: int, round_number: int, block_id: bytes) -> bytes:
    """Return the producer's 64-byte signature of its proposal."""
    return key.sign_compact(PROPOSAL_TAG, *proposal_parts(chain_id, epoch, round_number, block_id))


def is_valid_block_signature(
    chain_id: bytes, epoch: int, round_number: int, block_id: bytes, signature: bytes, public_key: bytes
) -> bool:
    """Tell whether `public_key` proposed the block of this id in this round."""
    return verify(public_key, PROPOSAL_TAG, signature, *proposal_parts(chain_id, epoch, round_number, block_id))


def is_genuine(word: Word, chain_id: bytes, public_key: bytes) -> bool:
    """Tell whether the word was signed by `public_key`. Never raises for anything a peer can send."""
    if not 0 <= word.epoch < 1 << 32 or not 0 < word.round < 1 << 53 or not 0 <= word.qc_round < 1 << 53:
        return False
    if word.kind == WORD_TIMEOUT:
        parts = timeout_parts(chain_id, word.epoch, word.round, word.qc_round)
        return verify(public_key, TIMEOUT_TAG, word.signature, *parts)
    if word.kind == WORD_VOTE:
        return verify(
            public_key, VOTE_TAG, word.signature, *vote_parts(chain_id, word.epoch, word.round, word.block_id)
        )
    if word.kind == WORD_PROPOSAL:
        parts = proposal_parts(chain_id, word.epoch, word.round, word.block_id)
        return verify(public_key, PROPOSAL_TAG, word.signature, *parts)
    return False
