"""The JSON documents of the explorer's routes.

A node whose explorer is public shows them to anybody, so what is added here is added for anybody.
"""

from __future__ import annotations

from node.api.documents import Document, Hex32, PublicKey


class CertificateDocument(Document, frozen=True):
    """A quorum certificate: `voters` are seats of the epoch. It holds exactly a quorum; later votes are left out."""

    epoch: int
    round: int
    block_id: Hex32
    voters: list[int]


class TimeoutDocument(Document, frozen=True):
    """A timeout certificate: by whom a round was given up, as seats, and the highest certified round they knew."""

    epoch: int
    round: int
    voters: list[int]
    highest_qc_round: int


class HeaderDocument(Document, frozen=True):
    """A finalized header, decoded. Sizes are counts; `transaction_count` is null once the block's body was pruned.

    `certificate` is the block's own, null if the node does not know it; `parent_certificate` is the one it carries.
    `finality_lag_ms`: its age when this node learned that it is final, by the node's clock; null if that was long ago.
    `missed_count` rounds were given up before it; `missed` are the seats that should have led them, the first 32.
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
    """Consecutive finalized headers, lowest first. `head` is the newest height, `earliest_height` the oldest body's."""

    head: int
    earliest_height: int
    headers: list[HeaderDocument]


class SeatDocument(Document, frozen=True):
    """A producer's seat in an epoch. `leads` is false for one that votes only."""

    index: int
    name: str
    key: PublicKey
    leads: bool


class EpochDocument(Document, frozen=True):
    """An epoch: its seats in the order of turns, how many votes make a quorum, how many faulty seats it bears."""

    number: int
    quorum: int
    faults_tolerated: int
    blocks_per_turn: int
    seats: list[SeatDocument]


class EvidenceDocument(Document, frozen=True):
    """Why a producer was suspended: `kind` is vote or proposal; the two different blocks that it signed in one round."""

    kind: str
    epoch: int
    round: int
    height: int
    first_id: Hex32
    second_id: Hex32


class ProducerDocument(Document, frozen=True):
    """A candidate or producer: whose it is, who votes for it or for its removal, its seat, its suspension."""

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
    """How many there are at the newest finalized height. No count is of people."""

    organisations: int
    nodes: int
    producers: int
    contracts: int


class RoundDocument(Document, frozen=True):
    """Where the node is in the protocol, by its own word: not final. `leader` is a seat of the epoch."""

    epoch: int
    round: int
    leader: int
    certified_height: int
    timed_out_count: int


class ExplorerStatusAnswer(Document, frozen=True):
    """Who answers, of which network, and how far it is. `is_public` tells whether anybody may ask."""

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
    """What a code of a receipt means. `origin` is machine, contract or catalogue; empty words are not known."""

    code: str
    origin: str
    meaning: str
    next_step: str
