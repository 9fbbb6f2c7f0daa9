"""Consensus core events, its only inputs; all are replayable."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import Block, QuorumCertificate
from consensus.chain.messages import CertificateNotice, LastSignedRequest, LastSignedResponse, Proposal, Timeout, Vote


@dataclass(frozen=True, slots=True)
class Started:
    """The node starts; `now_ms` is its wall clock, as in every event."""

    now_ms: int


@dataclass(frozen=True, slots=True)
class ProposalReceived:
    """A peer's proposal; `sender` is the authenticated producer index or None."""

    proposal: Proposal
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class VoteReceived:
    """A peer's vote; `sender` as in `ProposalReceived`."""

    vote: Vote
    now_ms: int
    sender: int | None = None


@dataclass(frozen=True, slots=True)
class TimeoutReceived:
    """A peer's timeout; `sender` as in `ProposalReceived`."""

    timeout: Timeout
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class NoticeReceived:
    """A peer's highest certificates."""

    notice: CertificateNotice
    now_ms: int


@dataclass(frozen=True, slots=True)
class LastSignedRequested:
    """A restarted producer asks for its last messages; `sender` is authenticated."""

    request: LastSignedRequest
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class LastSignedReceived:
    """An answer to `LastSignedRequest`; `sender` is authenticated."""

    answer: LastSignedResponse
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class BlockExecuted:
    """Answer to `ExecuteBlock`; `valid`: executed, admissible, roots equal.

    `fault`: not executable here, retried if certified (R41). `withheld`: gives up a feasible change (R42). Neither gets
    a vote.
    """

    block_id: bytes
    valid: bool
    now_ms: int
    fault: bool = False
    withheld: bool = False


@dataclass(frozen=True, slots=True)
class BlockBuilt:
    """Answer to `BuildBlock`: signed, executed block or None."""

    round: int
    block: Block | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class BlocksFetched:
    """Blocks from `FetchBlocks`, oldest first, unchecked."""

    blocks: tuple[Block, ...]
    now_ms: int


@dataclass(frozen=True, slots=True)
class FinalizedElsewhere:
    """Sync installed checked final blocks; continue above them."""

    head: Block
    qc: QuorumCertificate
    now_ms: int


@dataclass(frozen=True, slots=True)
class TimerFired:
    """A timer fired; `kind` and `round` are from `SetTimer`."""

    kind: str
    round: int
    now_ms: int


@dataclass(frozen=True, slots=True)
class WorkChanged:
    """Whether the mempool has an admissible transaction outside the certified branch."""

    pending: bool
    now_ms: int


@dataclass(frozen=True, slots=True)
class PeerConnected:
    """A producer connected; the core sends what it may have missed."""

    index: int
    now_ms: int


Event = (
    Started
    | ProposalReceived
    | VoteReceived
    | TimeoutReceived
    | NoticeReceived
    | LastSignedRequested
    | LastSignedReceived
    | BlockExecuted
    | BlockBuilt
    | BlocksFetched
    | FinalizedElsewhere
    | TimerFired
    | WorkChanged
    | PeerConnected
)
