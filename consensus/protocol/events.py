"""What happens to the consensus core: its only inputs. Must never carry anything that the core could not replay."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import Block, QuorumCertificate
from consensus.chain.messages import CertificateNotice, Proposal, Timeout, Vote, WordsAnswer, WordsRequest


@dataclass(frozen=True, slots=True)
class Started:
    """The node begins (or begins again). `now_ms` is the node's wall clock, as in every event."""

    now_ms: int


@dataclass(frozen=True, slots=True)
class ProposalReceived:
    """A peer's proposal. `sender` is the producer index behind the authenticated connection, or None."""

    proposal: Proposal
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class VoteReceived:
    """A peer's vote. `sender` is the producer index behind the authenticated connection, or None."""

    vote: Vote
    now_ms: int
    sender: int | None = None


@dataclass(frozen=True, slots=True)
class TimeoutReceived:
    """A peer's timeout. `sender` is the producer index of the connection, or None."""

    timeout: Timeout
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class NoticeReceived:
    """A peer's highest certificates."""

    notice: CertificateNotice
    now_ms: int


@dataclass(frozen=True, slots=True)
class WordsAsked:
    """A producer that just started asks what was last heard of it. `sender` is the index behind the connection."""

    request: WordsRequest
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class WordsAnswered:
    """A producer's answer to `WordsRequest`. `sender` is the index behind the connection."""

    answer: WordsAnswer
    sender: int | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class BlockExecuted:
    """The answer to `ExecuteBlock`. `valid`: executed, transactions admissible on that branch, roots equal.

    `fault`: it could not be executed, which says nothing about the block: no vote, and a certified one is executed again
    (R41). `withheld`: valid, but it gives up a change that this node could carry out: no vote (R42).
    """

    block_id: bytes
    valid: bool
    now_ms: int
    fault: bool = False
    withheld: bool = False


@dataclass(frozen=True, slots=True)
class BlockBuilt:
    """The answer to `BuildBlock`: the signed block, already executed, or None if none could be built."""

    round: int
    block: Block | None
    now_ms: int


@dataclass(frozen=True, slots=True)
class BlocksFetched:
    """Blocks that were asked for by `FetchBlocks`, oldest first. They are checked like any others."""

    blocks: tuple[Block, ...]
    now_ms: int


@dataclass(frozen=True, slots=True)
class FinalizedElsewhere:
    """Sync installed finalized blocks (checked against their certificates): the core continues above them."""

    head: Block
    qc: QuorumCertificate
    now_ms: int


@dataclass(frozen=True, slots=True)
class TimerFired:
    """A timer that the core had set ran out. `kind` and `round` are those of the `SetTimer`."""

    kind: str
    round: int
    now_ms: int


@dataclass(frozen=True, slots=True)
class WorkChanged:
    """Whether the mempool holds an admissible transaction outside the certified branch."""

    pending: bool
    now_ms: int


@dataclass(frozen=True, slots=True)
class PeerConnected:
    """A producer's connection came up: the core sends it what it may have missed."""

    index: int
    now_ms: int


Event = (
    Started
    | ProposalReceived
    | VoteReceived
    | TimeoutReceived
    | NoticeReceived
    | WordsAsked
    | WordsAnswered
    | BlockExecuted
    | BlockBuilt
    | BlocksFetched
    | FinalizedElsewhere
    | TimerFired
    | WorkChanged
    | PeerConnected
)
