"""What the consensus core wants done, in order: its only outputs. Must never be reordered around a `Persist`.

The driver carries the effects of one event out one after another; whatever stands behind a `Persist` waits until those
bytes are on the disk (journal, then speak).
"""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import Block, FinalityProof, QuorumCertificate, TimeoutCertificate
from consensus.chain.evidence import Evidence
from consensus.chain.messages import CertificateNotice, Proposal, Timeout, Vote, WordsAnswer, WordsRequest

Message = Proposal | Vote | Timeout | CertificateNotice | WordsRequest | WordsAnswer

TIMER_ROUND = "round"
TIMER_RESEND = "resend"
TIMER_HEARTBEAT = "heartbeat"
TIMER_PROPOSE = "propose"
TIMER_FETCH = "fetch"
TIMER_ASK = "ask"
TIMER_EXECUTE = "execute"


@dataclass(frozen=True, slots=True)
class Persist:
    """Append these journal records (canonical bytes) and sync them before the next effect."""

    records: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Send to all producers and followers, not to oneself (the core has already counted its own)."""

    message: Message


@dataclass(frozen=True, slots=True)
class SendTo:
    """Send to one producer."""

    index: int
    message: Message


@dataclass(frozen=True, slots=True)
class ExecuteBlock:
    """Execute the block on its parent and answer with `BlockExecuted`. The parent is finalized or was executed.

    A block that is `certified` was executed by others: whatever it takes to execute it here is to be given (R41).
    """

    block: Block
    certified: bool = False


@dataclass(frozen=True, slots=True)
class BuildBlock:
    """Take transactions (none if `empty`), execute, fill in and sign the header, answer with `BlockBuilt`.

    The timestamp is max(parent's + 1, the node's clock). `closing` (always `empty` too) goes into the header as
    `is_closing`: nothing is executed, the state root is the parent's.
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
    """These blocks are final, oldest first. `proof` is the two-chain proof of the last of them.

    The driver stores them durably; it may report later, in its own time, what the synced store holds
    (`Core.forget_journalled`). If the last one is a boundary, this core has ended (`Core.has_ended`), and once the store
    is synced the driver makes one for the next epoch.
    """

    blocks: tuple[Block, ...]
    proof: FinalityProof


@dataclass(frozen=True, slots=True)
class FetchBlocks:
    """Ask the given producers (signers of the certificate) for this block and its missing ancestors."""

    block_id: bytes
    above_height: int
    producers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SetTimer:
    """Start (or start again) the timer of this kind; `round` comes back in `TimerFired`."""

    kind: str
    round: int
    delay_ms: int


@dataclass(frozen=True, slots=True)
class CancelTimer:
    """Stop the timer of this kind, if it runs."""

    kind: str


@dataclass(frozen=True, slots=True)
class BlockCertified:
    """A block of the tree has a quorum: its transactions are on the certified branch (for the mempool)."""

    block_id: bytes


@dataclass(frozen=True, slots=True)
class ProposalLost:
    """The round of this node's own block was lost: perhaps others could not execute what it held (R41)."""

    block_id: bytes


@dataclass(frozen=True, slots=True)
class EvidenceFound:
    """A producer said two different things in one round (R30). The driver brings it before the contract `producers`."""

    evidence: Evidence


@dataclass(frozen=True, slots=True)
class LockoutChanged:
    """This producer signs nothing, for this reason and until then; or, both empty, it may sign again (for the log)."""

    reason: str
    until: str


@dataclass(frozen=True, slots=True)
class Halt:
    """A certified block comes out otherwise here, or the chain forked: stop signing, serve reads, raise the alarm."""

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
