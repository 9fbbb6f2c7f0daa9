"""Bundle JSON documents, versions 1 and 2; lower-case hexadecimal, Unix ms. `data/` follows from `proofs/`; types
define the JSON Schema.
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError

FORMAT = "blockrobot-export"
FORMAT_VERSION = 1
FORMAT_VERSION_EXTENDED = 2
"""Version 2 has `proofs/keys.json`, or `proofs/receipts.json` and `data/receipts.json`, or all three besides. A bundle
that needs none of them is written as version 1."""
FORMAT_VERSIONS = (FORMAT_VERSION, FORMAT_VERSION_EXTENDED)


class Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every part of a document."""


D = TypeVar("D", bound=Document)


# What is checked


class ChainProofs(Document, frozen=True):
    """Producer changes since genesis: one canonical `EpochProof` per epoch (formats.md)."""

    epochs: list[str]


class KeyProof(Document, frozen=True):
    """A state key, its encoded value (null: proved absent), and trie proof."""

    key: str
    value: str | None
    proof: str


class Snapshot(Document, frozen=True):
    """Keys proved under one final block; `finality` is a canonical `FinalityProof`."""

    finality: str
    keys: list[KeyProof]


class StateProofs(Document, frozen=True):
    """Proved state of one visit or the person; no key twice."""

    snapshots: list[Snapshot]


class ReceiptProof(Document, frozen=True):
    """A transaction's receipt: headers to a final block, finality proof, Merkle paths."""

    headers: list[str]
    finality: str
    receipt: str
    index: int
    count: int
    receipt_path: list[str]
    transaction_path: list[str]


class ReceiptProofs(Document, frozen=True):
    """Receipts of the person's consent transactions, in chain order."""

    receipts: list[ReceiptProof]


class KeyChange(Document, frozen=True):
    """A registration or rotation transaction of the person, and its receipt."""

    transaction: str
    proof: ReceiptProof


class KeyHistory(Document, frozen=True):
    """The person's key changes in chain order, showing former sealing keys."""

    steps: list[KeyChange]


class ReceiptEntry(Document, frozen=True):
    """One consent receipt: text, signatures, proofs; `person_signature` empty only while pending."""

    document: str
    controller_key: str
    controller_signature: str
    person_signature: str
    transaction: str
    proof: ReceiptProof
    state: StateProofs


class SignedReceipts(Document, frozen=True):
    """Consent receipts signed by both sides, in chain order."""

    receipts: list[ReceiptEntry]


class RecordOpening(Document, frozen=True):
    """What opens one record.

    `box_key` opens its metadata's sealed box (empty: unproved); `commitment_leaves`: none without pictures; `salts`:
    one per included frame, else empty.
    """

    record_id: str
    metadata: str
    box_key: str
    commitment_leaves: list[str]
    salts: list[str]


class CorrectionOpening(Document, frozen=True):
    """A correction's text and salt; `number` within the visit, from 0."""

    visit: str
    number: int
    kind: str
    record_ids: list[str]
    text: str
    salt: str


class RecordOpenings(Document, frozen=True):
    """Openings of all included records, and of corrections if identity is included."""

    records: list[RecordOpening]
    corrections: list[CorrectionOpening]


# What says what the bundle is


class Problem(Document, frozen=True):
    """A requested item not in the bundle: record (empty: all), code, sentence."""

    record_id: str
    code: str
    sentence: str


class Selection(Document, frozen=True):
    """The request. Empty `records`: all; time 0: no bound."""

    records: list[str]
    from_ms: int
    until_ms: int
    pictures: bool
    identity: bool
    purpose: str


class ManifestEntry(Document, frozen=True):
    """One file of the bundle."""

    name: str
    size: int
    sha256: str


class Manifest(Document, frozen=True):
    """The bundle's chain, missing parts, and every file except itself and signatures."""

    format: str
    version: int
    network: str
    chain_id: str
    genesis_id: str
    created_at_ms: int
    selection: Selection
    problems: list[Problem]
    entries: list[ManifestEntry]


class Signature(Document, frozen=True):
    """A 65-byte recoverable signature over H(export, chain id, SHA-256 of manifest.json)."""

    key: str
    signature: str


class Signatures(Document, frozen=True):
    """Signatures by each visit's owner key, and the member key if identity is included."""

    signatures: list[Signature]


# What is told


class FrameDocument(Document, frozen=True):
    """One frame; `status`: `picture`, `notice` (withheld frames), `undrawable`, `erased` or `absent`."""

    index: int
    status: str
    captured_at_ms: int
    sequence: int
    encoding: str
    committed: str
    files: list[str]


class RecordDocument(Document, frozen=True):
    """One record, 0 or empty where erased or unread; `metadata_proved`: as sealed by robot; `withheld` by reason."""

    record_id: str
    number: int
    status: str
    robot: str
    bucket_ms: int
    expires_at_ms: int
    recorded_at_height: int
    transaction: str
    commitment_root: str
    metadata_proved: bool
    sensor: str
    started_at_ms: int
    ended_at_ms: int
    frame_count: int
    index_in_visit: int
    width: int
    height: int
    withheld: dict[str, int]
    erased_frames: list[int]
    verdict: str
    frames: list[FrameDocument]


class VisitDocument(Document, frozen=True):
    """Records under one owner key; `missing` from its hash chain, -1 if partial."""

    number: int
    owner: str
    robot: str
    purpose: str
    bucket_ms: int
    status: str
    record_count: int
    missing: int
    is_whole: bool
    proved_from_height: int
    proved_until_height: int
    records: list[RecordDocument]


class VisitsDocument(Document, frozen=True):
    """data/visits.json: what was recorded."""

    visits: list[VisitDocument]


class AuditDocument(Document, frozen=True):
    """One visit event; `data` by kind, bytes hexadecimal."""

    owner: str
    index: int
    record_id: str
    kind: str
    time_ms: int
    height: int
    data: Any


class AuditTrailDocument(Document, frozen=True):
    """data/audit.json: all events in chain order."""

    entries: list[AuditDocument]


class AccessDocument(Document, frozen=True):
    """One access request; empty `records`: whole visit."""

    access_id: str
    owner: str
    records: list[str]
    purpose: str
    time_ms: int
    released: dict[str, int]
    refused: dict[str, str]


class AccessLogDocument(Document, frozen=True):
    """data/access.json: who requested pictures, why, and custodians' answers."""

    accesses: list[AccessDocument]


class ErasureReceiptDocument(Document, frozen=True):
    """A custodian's confirmation of destruction, and what remains until when."""

    custodian: str
    destroyed_frames: int
    remains: str
    remains_until_ms: int
    digest: str
    time_ms: int


class ErasureDocument(Document, frozen=True):
    """One erasure request and its receipts. Empty `frames`: whole records."""

    erasure_id: str
    owner: str
    records: list[str]
    frames: list[int]
    status: str
    time_ms: int
    custodians: list[str]
    receipts: list[ErasureReceiptDocument]


class ErasuresDocument(Document, frozen=True):
    """data/erasures.json: what was erased, and who confirmed."""

    erasures: list[ErasureDocument]


class VisitRightsDocument(Document, frozen=True):
    """A visit's restriction, objections, quarantine (breach id) and corrections; null: none, empty `text`: unopened."""

    owner: str
    restriction: Any
    objection: Any
    quarantine: Any
    corrections: Any


class RightsDocument(Document, frozen=True):
    """data/rights.json: restriction, objection and rectification of every visit."""

    visits: list[VisitRightsDocument]


class ConsentStepDocument(Document, frozen=True):
    """Consent status from a height; 0: no bound; `mandate` id, or empty."""

    from_height: int
    status: str
    since_ms: int
    period_from_ms: int
    period_until_ms: int
    mandate: str


class ConsentDocument(Document, frozen=True):
    """One purpose and sensor: current and future consent status."""

    purpose: str
    sensor: str
    steps: list[ConsentStepDocument]


class ConsentWordDocument(Document, frozen=True):
    """One consent transaction (`given`, `refused`, `withdrawn` or `objected`), proved by its receipt."""

    kind: str
    purposes: list[str]
    sensors: list[str]
    from_height: int
    transaction: str
    height: int
    time_ms: int


class ConsentsDocument(Document, frozen=True):
    """data/consents.json: identity (empty: left out), present consents and history."""

    member: str
    handle: str
    role: str
    status: str
    proved_at_height: int
    last_word_height: int
    choices: list[ConsentDocument]
    history: list[ConsentWordDocument]


class SignedReceiptDocument(Document, frozen=True):
    """One receipt (ISO/IEC TS 27560); signed bytes: `receipt` as ASCII JSON, sorted keys, no spaces; notice 0: none."""

    transaction: str
    status: str
    height: int
    time_ms: int
    organisation: str
    node: str
    notice_version: int
    notice_hash: str
    controller_key: str
    controller_signature: str
    person_key: str
    person_signature: str
    receipt: Any


class SignedReceiptsDocument(Document, frozen=True):
    """data/receipts.json: consent receipts signed by organisation and person."""

    receipts: list[SignedReceiptDocument]


DOCUMENTS: tuple[tuple[str, type[Document]], ...] = (
    ("manifest.json", Manifest),
    ("signatures.json", Signatures),
    ("data/visits.json", VisitsDocument),
    ("data/audit.json", AuditTrailDocument),
    ("data/access.json", AccessLogDocument),
    ("data/erasures.json", ErasuresDocument),
    ("data/rights.json", RightsDocument),
    ("data/consents.json", ConsentsDocument),
    ("proofs/chain.json", ChainProofs),
    ("proofs/state-NNN.json", StateProofs),
    ("proofs/consents.json", ReceiptProofs),
    ("proofs/records.json", RecordOpenings),
)
DOCUMENTS_EXTENDED: tuple[tuple[str, type[Document]], ...] = (
    *DOCUMENTS,
    ("data/receipts.json", SignedReceiptsDocument),
    ("proofs/keys.json", KeyHistory),
    ("proofs/receipts.json", SignedReceipts),
)


def write_document(document: Document) -> bytes:
    """Return canonical JSON: ordered fields, indent 1, trailing newline."""
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def read_document(name: str, content: bytes, kind: type[D]) -> D:
    """Read canonical JSON only. Raises BUNDLE_INVALID."""
    try:
        document = read_json_as(content, kind)
    except TextInvalidError as error:
        raise BlockRobotError("BUNDLE_INVALID", f"{name} is no {kind.__name__}: {error}.") from None
    if write_document(document) != content:
        raise BlockRobotError("BUNDLE_INVALID", f"{name} is not written as a bundle has it; it was changed.")
    return document


def read_bytes(name: str, text: str) -> bytes:
    """Read lower-case hexadecimal. Raises BUNDLE_INVALID."""
    try:
        data = bytes.fromhex(text)
    except ValueError:
        data = b""
    if data.hex() != text:
        raise BlockRobotError("BUNDLE_INVALID", f"{name} holds text where bytes are due.")
    return data


def make_schema(version: int) -> dict[str, Any]:
    """Return a version's JSON Schema (2020-12)."""
    documents = DOCUMENTS if version == FORMAT_VERSION else DOCUMENTS_EXTENDED
    kinds = [kind for _, kind in documents]
    _, components = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{FORMAT}, version {version}",
        "x-files": {name: {"$ref": f"#/$defs/{kind.__name__}"} for name, kind in documents},
        "$defs": dict(sorted(components.items())),
    }
