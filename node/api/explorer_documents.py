"""JSON documents of the explorer's routes.

A node with a public explorer shows all of their fields to anybody.
"""

from __future__ import annotations

from consensus.api_documents import Document, Hex32, PublicKey


class CertificateDocument(Document, frozen=True):
    """A quorum certificate; `voters` are seats of the epoch, exactly a quorum."""

    epoch: int
    round: int
    block_id: Hex32
    voters: list[int]


class TimeoutDocument(Document, frozen=True):
    """A timeout certificate: the seats that gave up, and their highest certified round."""

    epoch: int
    round: int
    voters: list[int]
    highest_qc_round: int


class HeaderDocument(Document, frozen=True):
    """A finalized header. Sizes are counts; `transaction_count` is null once pruned.

    `certificate`: the block's own (null: unknown); `parent_certificate`: carried. `finality_lag_ms`: age when learned
    final (null: long ago). `missed_count`: rounds given up before; `missed`: first 32 seats.
    """

    height: int
    block_id: Hex32
    version: int
    epoch: int
    round: int
    parent_id: Hex32
    producer: int
    timestamp_ms: int
    transactions_root: Hex32
    receipts_root: Hex32
    state_root: Hex32
    transaction_count: int | None
    gas_used: int
    finality_lag_ms: int | None
    is_boundary: bool
    is_closing: bool
    certificate: CertificateDocument | None
    parent_certificate: CertificateDocument
    timeout: TimeoutDocument | None
    missed_count: int
    missed: list[int]


class ExplorerHeadersAnswer(Document, frozen=True):
    """Consecutive finalized headers, lowest first; `earliest_height` is the oldest body's."""

    head: int
    earliest_height: int
    headers: list[HeaderDocument]


class SeatDocument(Document, frozen=True):
    """A producer's seat in an epoch; `leads` is false for voting only."""

    index: int
    name: str
    key: PublicKey
    leads: bool


class EpochDocument(Document, frozen=True):
    """An epoch: seats in turn order, quorum size, tolerated faulty seats."""

    number: int
    quorum: int
    faults_tolerated: int
    blocks_per_turn: int
    seats: list[SeatDocument]


class EvidenceDocument(Document, frozen=True):
    """A suspension's reason: `kind` (vote or proposal) and two conflicting signed blocks of one round."""

    kind: str
    epoch: int
    round: int
    height: int
    first_id: Hex32
    second_id: Hex32


class ProducerDocument(Document, frozen=True):
    """A candidate or producer: owner, votes for and against, seat, suspension."""

    name: str
    organisation: str
    key: PublicKey
    status: str
    votes: list[str]
    removals: list[str]
    seat: int | None
    suspended_height: int
    evidence: EvidenceDocument | None


class ProducersAnswer(Document, frozen=True):
    """All candidates and producers at the newest finalized height."""

    height: int
    epoch: int
    producers: list[ProducerDocument]


class CountsDocument(Document, frozen=True):
    """Counts at the newest finalized height; none is of people."""

    organisations: int
    nodes: int
    producers: int
    contracts: int


class RoundDocument(Document, frozen=True):
    """The node's own, unfinalized protocol position; `leader` is an epoch seat."""

    epoch: int
    round: int
    leader: int
    certified_height: int
    timed_out_count: int


class ExplorerStatusAnswer(Document, frozen=True):
    """The answering node, its network and progress; `is_public`: anybody may ask."""

    node: str
    network: str
    chain_id: Hex32
    now_ms: int
    is_public: bool
    head: int
    earliest_height: int
    epoch: int
    rounds: RoundDocument | None
    counts: CountsDocument


class RefusalAnswer(Document, frozen=True):
    """A receipt code's meaning; `origin` is machine, contract or catalogue; empty if unknown."""

    code: str
    origin: str
    meaning: str
    next_step: str
