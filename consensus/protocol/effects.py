"""Consensus core effects, executed in order, none before a pending `Persist`."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import Block, FinalityProof, QuorumCertificate, TimeoutCertificate
from consensus.chain.evidence import Evidence
from consensus.chain.messages import CertificateNotice, LastSignedRequest, LastSignedResponse, Proposal, Timeout, Vote

Message = Proposal | Vote | Timeout | CertificateNotice | LastSignedRequest | LastSignedResponse

TIMER_ROUND = "round"
TIMER_RESEND = "resend"
TIMER_HEARTBEAT = "heartbeat"
TIMER_PROPOSE = "propose"
TIMER_FETCH = "fetch"
TIMER_ASK = "ask"
TIMER_EXECUTE = "execute"


@dataclass(frozen=True, slots=True)
class Persist:
    """Append and sync journal records before the next effect."""

    records: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Send to all producers and followers except oneself."""

    message: Message


@dataclass(frozen=True, slots=True)
class SendTo:
    """Send to one producer."""

    index: int
    message: Message


@dataclass(frozen=True, slots=True)
class ExecuteBlock:
    """Execute on the executed or finalized parent; answer with `BlockExecuted`.

    `certified` blocks get all resources needed: others executed them (R41).
    """

    block: Block
    certified: bool = False


@dataclass(frozen=True, slots=True)
class BuildBlock:
    """Build (no transactions if `empty`), execute and sign; answer with `BlockBuilt`.

    Timestamp: max(parent's + 1, clock). `closing` sets `is_closing`: nothing executed, parent's state root.
    """

    epoch: int
    round: int
    height: int
    parent_id: bytes
    parent_timestamp_ms: int
    qc: QuorumCertificate
    tc: TimeoutCertificate | None
    producer: int
    empty: bool
    closing: bool = False


@dataclass(frozen=True, slots=True)
class CommitBlocks:
    """Final blocks, oldest first; `proof` is the last one's two-chain proof.

    A final boundary ends this core; once synced, make the next.
    """

    blocks: tuple[Block, ...]
    proof: FinalityProof


@dataclass(frozen=True, slots=True)
class FetchBlocks:
    """Ask the certificate's signers for a block and missing ancestors."""

    block_id: bytes
    above_height: int
    producers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SetTimer:
    """Restart this kind's timer; `TimerFired` returns `round`."""

    kind: str
    round: int
    delay_ms: int


@dataclass(frozen=True, slots=True)
class CancelTimer:
    """Stop this kind's timer."""

    kind: str


@dataclass(frozen=True, slots=True)
class BlockCertified:
    """A block has a quorum; for the mempool."""

    block_id: bytes


@dataclass(frozen=True, slots=True)
class ProposalLost:
    """The own block's round was lost, perhaps unexecutable by others (R41)."""

    block_id: bytes


@dataclass(frozen=True, slots=True)
class EvidenceFound:
    """Equivocation found (R30); report it to the contract `producers`."""

    evidence: Evidence


@dataclass(frozen=True, slots=True)
class LockoutChanged:
    """The signing lockout and its reason; both empty when lifted (logged)."""

    reason: str
    until: str


@dataclass(frozen=True, slots=True)
class Halt:
    """Diverging execution or fork: stop signing, serve reads, raise the alarm."""

    reason: str


Effect = (
    Persist
    | Broadcast
    | SendTo
    | ExecuteBlock
    | BuildBlock
    | CommitBlocks
    | FetchBlocks
    | SetTimer
    | CancelTimer
    | BlockCertified
    | ProposalLost
    | EvidenceFound
    | LockoutChanged
    | Halt
)
