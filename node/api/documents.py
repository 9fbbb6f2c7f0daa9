"""The JSON documents of the interface.

Bytes are lower-case hexadecimal. The same types check requests, write answers and make the OpenAPI schemas.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from consensus.chain.block import FinalityProof
from consensus.primitives.encoding import encode

PROOF_KEYS_MAX_COUNT = 128
PAGE_MAX_COUNT = 100
EPOCHS_PAGE_MAX_COUNT = 16

HexBytes = Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{2})*$", description="bytes in lower-case hexadecimal")]
Hex32 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", description="32 bytes in lower-case hexadecimal")]
PublicKey = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{66}$", description="a compressed secp256k1 key")]
Signature = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{130}$", description="a recoverable signature, r||s||v")]
StateKey = Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{2}){3,161}$", description="contract name, 0x00, key")]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=32)]


class Document(msgspec.Struct, forbid_unknown_fields=True, frozen=True, gc=False):
    """Base of every JSON object of the interface."""


class Problem(Document, frozen=True):
    """A refusal (RFC 9457), with its code of the catalogue."""

    type: str
    title: str
    status: int
    code: str
    detail: str
    next_step: str
    retryable: bool


class SubmitOutcome(Document, frozen=True):
    """What became of one transaction. `error` is set if it was rejected; `txid` is null if it was unreadable."""

    txid: Hex32 | None
    status: str
    error: Problem | None


class SubmitAnswer(Document, frozen=True):
    """One result for each submitted transaction, in order."""

    results: list[SubmitOutcome]


class ReceiptDocument(Document, frozen=True):
    """What the contract said."""

    ok: bool
    code: str
    message: str
    line: int | None
    gas_used: int


class Finality(Document, frozen=True):
    """The proof that a block is final: its header, its child of the next round, the child's certificate.

    `through` holds the headers between the header and the certified pair; only boundaries of epochs have any.
    """

    header: HexBytes
    child_header: HexBytes
    child_qc: HexBytes
    through: list[HexBytes]


class TransactionEvidence(Document, frozen=True):
    """What proves a receipt to a client that trusts no node.

    `headers` lead from the block of the transaction (first) to the block that `finality` proves (last). The receipt
    and the txid have Merkle paths to the roots in the first header.
    """

    headers: list[HexBytes]
    finality: Finality
    receipt: HexBytes
    count: int
    receipt_path: list[Hex32]
    transaction_path: list[Hex32]


class TransactionState(Document, frozen=True):
    """Where a transaction is: pending, finalized, unknown or expired. The other fields are set once it is final."""

    txid: Hex32
    status: str
    height: int | None
    index: int | None
    block_id: Hex32 | None
    receipt: ReceiptDocument | None
    evidence: TransactionEvidence | None


class ChallengeRequest(Document, frozen=True):
    """Ask for a challenge."""

    public_key: PublicKey


class ChallengeAnswer(Document, frozen=True):
    """A single-use challenge."""

    challenge: Hex32
    expires_at_ms: int


class SessionRequest(Document, frozen=True):
    """A signed challenge; with the grant's id, if the key is to be the grantee's of it."""

    public_key: PublicKey
    challenge: Hex32
    signature: Signature
    grant: Hex32 | None = None


class SessionAnswer(Document, frozen=True):
    """An open session."""

    token: Hex32
    kind: str
    expires_at_ms: int


class FinalityAnswer(Document, frozen=True):
    """The newest finalized block. `finality` is null while only genesis is final."""

    height: int
    finality: Finality | None


class EpochsAnswer(Document, frozen=True):
    """The proofs that began the epochs after the one asked for, in order: a page of them."""

    epochs: list[HexBytes]


class HeadersAnswer(Document, frozen=True):
    """Consecutive finalized headers."""

    from_height: int
    headers: list[HexBytes]


class ProofsRequest(Document, frozen=True):
    """Flat keys to prove, all from one snapshot."""

    keys: Annotated[list[StateKey], msgspec.Meta(min_length=1, max_length=PROOF_KEYS_MAX_COUNT)]


class KeyProof(Document, frozen=True):
    """One key with its value (null if absent) and the proof of that."""

    key: HexBytes
    value: HexBytes | None
    proof: HexBytes


class ProofsAnswer(Document, frozen=True):
    """Proved keys under one state root."""

    finality: Finality | None
    proofs: list[KeyProof]


class QueryRequest(Document, frozen=True):
    """A call of a read-only entry. `args` is an encoded list of positional arguments."""

    contract: Name
    view: Name
    args: HexBytes


class QueryAnswer(Document, frozen=True):
    """The encoded result of a view and the height it was read at."""

    result: HexBytes
    height: int


class AnnouncementItem(Document, frozen=True):
    """One opened visit, or (with `root`, the visit's first owner key) its new owner key: what a wallet scans."""

    number: int
    owner: PublicKey
    ephemeral: PublicKey
    view_tag: int
    bucket_ms: int
    robot: PublicKey
    root: PublicKey | None = None


class AnnouncementsAnswer(Document, frozen=True):
    """A page of announcements with proofs of the count and of each, so that none can be left out unnoticed."""

    count: int
    items: list[AnnouncementItem]
    finality: Finality | None
    proofs: list[KeyProof]


class BlockSummary(Document, frozen=True):
    """One finalized block in a list."""

    height: int
    block_id: Hex32
    round: int
    producer: int
    timestamp_ms: int
    transaction_count: int
    gas_used: int


class BlocksAnswer(Document, frozen=True):
    """Consecutive finalized blocks. `head` is the height of the newest one, `earliest_height` that of the oldest here."""

    head: int
    earliest_height: int
    blocks: list[BlockSummary]


class EventItem(Document, frozen=True):
    """One event of a finalized block. `place` is height:index, the same at every node; `data` is an encoded dict."""

    place: str
    contract: str
    name: str
    data: HexBytes
    txid: Hex32


class EventsPage(Document, frozen=True):
    """Events in order. `next` is where to go on: nothing before it is left to read."""

    head: int
    earliest_height: int
    next: str
    events: list[EventItem]


class BlockAnswer(Document, frozen=True):
    """One finalized block with its transactions' ids and receipts, and its canonical bytes."""

    summary: BlockSummary
    block: HexBytes
    txids: list[Hex32]
    receipts: list[ReceiptDocument]


class BackgroundAnswer(Document, frozen=True):
    """A stored empty frame."""

    sha256: Hex32


class UploadAnswer(Document, frozen=True):
    """A staged clip."""

    record_id: str
    status: str


def finality_document(proof: FinalityProof | None) -> Finality | None:
    """Return the JSON form of a finality proof."""
    if proof is None:
        return None
    return Finality(
        header=proof.header_bytes.hex(),
        child_header=proof.child_header_bytes.hex(),
        child_qc=encode(proof.child_qc).hex(),
        through=[header.hex() for header in proof.through],
    )


class ConsentReceiptRequest(Document, frozen=True):
    """The transaction in which the caller said something about consent."""

    txid: Hex32


class ConsentReceiptAnswer(Document, frozen=True):
    """The receipt, JSON as a text; who signed its bytes for the organisation; the transaction's wire bytes."""

    document: str
    key: PublicKey
    signature: HexBytes
    transaction: HexBytes
