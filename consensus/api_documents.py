"""JSON documents of the HTTP interface: nodes write them, clients read them, OpenAPI describes them.

Bytes are lower-case hexadecimal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

import msgspec
from msgspec import UNSET, UnsetType

from consensus.chain.block import FinalityProof
from consensus.primitives.encoding import encode

PROOF_KEYS_MAX_COUNT = 128
PAGE_MAX_COUNT = 100
EPOCHS_PAGE_MAX_COUNT = 16
ANNOUNCEMENTS_PAGE_MAX_COUNT = 200

_HEX = "^([0-9a-f]{2})*$"
_IN_HEX = "bytes in lower-case hexadecimal"
HexBytes = Annotated[str, msgspec.Meta(extra_json_schema={"pattern": _HEX}, description=_IN_HEX)]
"""In answers of any size: who reads one decodes it, which checks it in less time and memory than the pattern."""
HexArguments = Annotated[str, msgspec.Meta(pattern=_HEX, description=_IN_HEX)]
Hex32 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", description="32 bytes in lower-case hexadecimal")]
PublicKey = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{66}$", description="a compressed secp256k1 key")]
Signature = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{130}$", description="a recoverable signature, r||s||v")]
StateKey = Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{2}){3,161}$", description="contract name, 0x00, key")]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=32)]


class Document(msgspec.Struct, frozen=True, gc=False):
    """Base of every JSON object; a reader passes over fields that it does not know, of a later version."""


class Request(Document, forbid_unknown_fields=True, frozen=True):
    """Base of every request; a node rejects one with a field that it does not know."""


D = TypeVar("D", bound=Document)


def describe(kind: type[D], row: object, **others: object) -> D:
    """Return the document with `others` and a row's fields of the same names, bytes as hexadecimal."""
    build: Callable[..., D] = kind
    return build(
        **{name: _shown(others[name] if name in others else getattr(row, name)) for name in kind.__struct_fields__}
    )


def _shown(value: object) -> object:
    if isinstance(value, list | tuple):
        return [_shown(each) for each in value]
    return value.hex() if isinstance(value, bytes) else value


class Problem(Document, frozen=True):
    """A refusal (RFC 9457) with its catalogue code. A node says all of it; a proxy in between may leave out any."""

    type: str = "about:blank"
    title: str = ""
    status: int = 0
    code: str = ""
    detail: str = ""
    next_step: str = ""
    retryable: bool = False


class SubmitOutcome(Document, frozen=True):
    """Result of one transaction: `error` if rejected; `txid` null if unreadable."""

    txid: Hex32 | None
    status: str
    error: Problem | None


class SubmitAnswer(Document, frozen=True):
    """One result for each submitted transaction, in order."""

    results: list[SubmitOutcome]


class ReceiptDocument(Document, frozen=True):
    """The contract's result for a transaction."""

    ok: bool
    code: str
    message: str
    line: int | None
    gas_used: int


class Finality(Document, frozen=True):
    """Proof of finality: header, child of the next round, the child's certificate.

    `through`: headers between the header and the certified pair, only at epoch boundaries.
    """

    header: HexBytes
    child_header: HexBytes
    child_qc: HexBytes
    through: list[HexBytes]


class TransactionEvidence(Document, frozen=True):
    """Evidence that proves a receipt without trusting a node.

    `headers` lead from the transaction's block to the one `finality` proves; Merkle paths end at the first header's
    roots.
    """

    headers: list[HexBytes]
    finality: Finality
    receipt: HexBytes
    count: int
    receipt_path: list[Hex32]
    transaction_path: list[Hex32]


class TransactionState(Document, frozen=True):
    """A transaction's state: pending, finalized, unknown or expired; other fields only once final."""

    txid: Hex32
    status: str
    height: int | None
    index: int | None
    block_id: Hex32 | None
    receipt: ReceiptDocument | None
    evidence: TransactionEvidence | None


class ChallengeRequest(Request, frozen=True):
    """Ask for a challenge."""

    public_key: PublicKey


class ChallengeAnswer(Document, frozen=True):
    """A single-use challenge."""

    challenge: Hex32
    expires_at_ms: int


class SessionRequest(Request, frozen=True):
    """A signed challenge; with a grant's id for its grantee."""

    public_key: PublicKey
    challenge: Hex32
    signature: Signature
    grant: Hex32 | UnsetType = UNSET


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
    """A page of epoch proofs after the epoch asked for, in order."""

    epochs: list[HexBytes]


class HeadersAnswer(Document, frozen=True):
    """Consecutive finalized headers."""

    from_height: int
    headers: list[HexBytes]


class ProofsRequest(Request, frozen=True):
    """Flat keys to prove, all from one snapshot."""

    keys: Annotated[list[StateKey], msgspec.Meta(min_length=1, max_length=PROOF_KEYS_MAX_COUNT)]


class KeyProof(Document, frozen=True):
    """A key, its value (null if absent) and the proof."""

    key: HexBytes
    value: HexBytes | None
    proof: HexBytes


class ProofsAnswer(Document, frozen=True):
    """Proved keys under one state root."""

    finality: Finality | None
    proofs: list[KeyProof]


class QueryRequest(Request, frozen=True):
    """A call of a read-only entry; `args` is an encoded positional list."""

    contract: Name
    view: Name
    args: HexArguments


class QueryAnswer(Document, frozen=True):
    """A view's encoded result and the height it was read at."""

    result: HexBytes
    height: int


class AnnouncementItem(Document, frozen=True):
    """An opened visit, or (with `root`, the first owner key) a new owner key."""

    number: int
    owner: PublicKey
    ephemeral: PublicKey
    view_tag: int
    bucket_ms: int
    robot: PublicKey
    root: PublicKey | None = None


class AnnouncementsAnswer(Document, frozen=True):
    """A page of announcements, with proofs of the count and each item."""

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
    """Consecutive finalized blocks; `head` is the newest height, `earliest_height` the oldest kept."""

    head: int
    earliest_height: int
    blocks: list[BlockSummary]


class EventItem(Document, frozen=True):
    """A finalized event; `place` is height:index, alike everywhere; `data` is an encoded dict."""

    place: str
    contract: str
    name: str
    data: HexBytes
    txid: Hex32


class EventsPage(Document, frozen=True):
    """Events in order; `next` is the place to continue from."""

    head: int
    earliest_height: int
    next: str
    events: list[EventItem]


class BlockAnswer(Document, frozen=True):
    """A finalized block with transaction ids, receipts and canonical bytes."""

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
    if proof is None:
        return None
    return Finality(
        header=proof.header_bytes.hex(),
        child_header=proof.child_header_bytes.hex(),
        child_qc=encode(proof.child_qc).hex(),
        through=[header.hex() for header in proof.through],
    )


class ConsentReceiptRequest(Request, frozen=True):
    """The transaction with the caller's consent statement."""

    txid: Hex32


class ConsentReceiptAnswer(Document, frozen=True):
    """The receipt's JSON text, who signed its bytes, the transaction's wire bytes."""

    document: str
    key: PublicKey
    signature: HexBytes
    transaction: HexBytes
