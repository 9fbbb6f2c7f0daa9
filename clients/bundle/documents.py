"""The bundle's JSON documents, versions 1 and 2, as types.

The documents under `proofs/` are what is checked; those under `data/` are the same, told so that people and other
programs can use it, and follow from the proofs byte for byte. Bytes are lower-case hexadecimal, times milliseconds
since 1970 (UTC). The JSON Schema is made from these types.
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
    """How the network's producers changed since genesis: one `EpochProof` (formats.md, canonical bytes) for each epoch."""

    epochs: list[str]


class KeyProof(Document, frozen=True):
    """One key of the ledger's state, its encoded value (null: proved absent), and the trie proof that leads to it."""

    key: str
    value: str | None
    proof: str


class Snapshot(Document, frozen=True):
    """Keys proved under one finalized block. `finality` is a `FinalityProof` in its canonical bytes."""

    finality: str
    keys: list[KeyProof]


class StateProofs(Document, frozen=True):
    """What the ledger's state holds of one visit, or of the person. No key is proved twice."""

    snapshots: list[Snapshot]


class ReceiptProof(Document, frozen=True):
    """One transaction's receipt: headers from its block to a final one, that block's proof, Merkle paths to the roots."""

    headers: list[str]
    finality: str
    receipt: str
    index: int
    count: int
    receipt_path: list[str]
    transaction_path: list[str]


class ReceiptProofs(Document, frozen=True):
    """The receipts of what the person said about consent, in the order of the chain."""

    receipts: list[ReceiptProof]


class KeyChange(Document, frozen=True):
    """A transaction by which the person got keys (she registered, or put new keys in place), and its receipt."""

    transaction: str
    proof: ReceiptProof


class KeyHistory(Document, frozen=True):
    """How the person came to her present keys, in the order of the chain: which sealing keys were hers before."""

    steps: list[KeyChange]


class ReceiptEntry(Document, frozen=True):
    """One consent receipt: its bytes as a text, both signatures, and all that proves it.

    `state` proves the node that signed, the member, the version of the notice that was in force and the next one.
    `person_signature` may be empty only between the organisation's signature and hers.
    """

    document: str
    controller_key: str
    controller_signature: str
    person_signature: str
    transaction: str
    proof: ReceiptProof
    state: StateProofs


class SignedReceipts(Document, frozen=True):
    """The consent receipts that both sides signed, in the order of the chain."""

    receipts: list[ReceiptEntry]


class RecordOpening(Document, frozen=True):
    """What opens one record for a reader, and nothing else of the person.

    `metadata` is the struct that was sealed to her; `box_key` opens that one sealed box on the chain (empty: the
    metadata is the exporter's word). `commitment_leaves` are all leaves under the record's root (none: the pictures are
    not in the bundle); `salts` has a salt for each leaf whose frame is in the bundle, and an empty text for the others.
    """

    record_id: str
    metadata: str
    box_key: str
    commitment_leaves: list[str]
    salts: list[str]


class CorrectionOpening(Document, frozen=True):
    """What the person said in a correction, and the salt that shows it to be what the ledger has the commitment of.

    `number` is the correction's place among those of the visit with this owner key, from 0.
    """

    visit: str
    number: int
    kind: str
    record_ids: list[str]
    text: str
    salt: str


class RecordOpenings(Document, frozen=True):
    """The openings of all records whose metadata is in the bundle, and of corrections (with the identity only)."""

    records: list[RecordOpening]
    corrections: list[CorrectionOpening]


# What says what the bundle is


class Problem(Document, frozen=True):
    """Something that was asked for and is not in the bundle: of which record (empty: of all), a code and a sentence."""

    record_id: str
    code: str
    sentence: str


class Selection(Document, frozen=True):
    """What was asked for. Empty `records`: all. 0 is no bound in time. `identity`: consents and who the person is."""

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
    """What the bundle is, of which chain, what is missing, and every file but this and the signatures."""

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
    """A recoverable signature (65 bytes) over H(export, chain id, SHA-256 of manifest.json) by this key."""

    key: str
    signature: str


class Signatures(Document, frozen=True):
    """Signed by the owner key of every visit in the bundle, and by the member key if the person is in it."""

    signatures: list[Signature]


# What is told


class FrameDocument(Document, frozen=True):
    """One frame. `status`: `picture`, `notice` (only tells of withheld frames), `undrawable`, `erased` or `absent`."""

    index: int
    status: str
    captured_at_ms: int
    sequence: int
    encoding: str
    committed: str
    files: list[str]


class RecordDocument(Document, frozen=True):
    """One record. Times of the robot's clock, counts and sensor are 0 or empty where the record is erased or unread.

    `metadata_proved` tells whether they are shown to be what the robot sealed. `withheld` counts frames, by reason.
    """

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
    """One visit: the records under one owner key. `missing` counts records that its own chain of hashes lacks.

    `missing` is -1 where only a part of the visit is in the bundle. The state was proved between the two heights.
    """

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
    """One event of a visit, by the contracts. `data` depends on the kind; bytes in it are hexadecimal."""

    owner: str
    index: int
    record_id: str
    kind: str
    time_ms: int
    height: int
    data: Any


class AuditTrailDocument(Document, frozen=True):
    """data/audit.json: everything that happened, in the order of the chain."""

    entries: list[AuditDocument]


class AccessDocument(Document, frozen=True):
    """One request to see records, by the visit's owner. Empty `records`: the whole visit. By custodian's key."""

    access_id: str
    owner: str
    records: list[str]
    purpose: str
    time_ms: int
    released: dict[str, int]
    refused: dict[str, str]


class AccessLogDocument(Document, frozen=True):
    """data/access.json: who asked for pictures, why, and what custodians answered."""

    accesses: list[AccessDocument]


class ErasureReceiptDocument(Document, frozen=True):
    """One custodian's word that it destroyed what was asked, and what remains until when."""

    custodian: str
    destroyed_frames: int
    remains: str
    remains_until_ms: int
    digest: str
    time_ms: int


class ErasureDocument(Document, frozen=True):
    """One request for erasure and its receipts. Empty `frames`: whole records."""

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
    """One visit: its restriction, objections, quarantine (the breach's id) and corrections, as the ledger holds them.

    null where there is none; `text` of a correction is empty where its maker did not open it. What the fields mean says
    the contract `rights` (docs/reference/system-contracts.md).
    """

    owner: str
    restriction: Any
    objection: Any
    quarantine: Any
    corrections: Any


class RightsDocument(Document, frozen=True):
    """data/rights.json: restriction, objection and rectification, of every visit."""

    visits: list[VisitRightsDocument]


class ConsentStepDocument(Document, frozen=True):
    """From a height on a status (`given`, `refused`, `withdrawn`, `objected`) holds; 0 is no bound of the period.

    `mandate` is the id of the mandate under which another person said it for her, empty if she said it herself.
    """

    from_height: int
    status: str
    since_ms: int
    period_from_ms: int
    period_until_ms: int
    mandate: str


class ConsentDocument(Document, frozen=True):
    """One purpose and sensor: what holds, and what is still to come."""

    purpose: str
    sensor: str
    steps: list[ConsentStepDocument]


class ConsentWordDocument(Document, frozen=True):
    """One word that the ledger took: `given`, `refused`, `withdrawn` or `objected`, proved by its transaction's receipt."""

    kind: str
    purposes: list[str]
    sensors: list[str]
    from_height: int
    transaction: str
    height: int
    time_ms: int


class ConsentsDocument(Document, frozen=True):
    """data/consents.json: who the person is to the ledger, what holds now, and what she said before.

    Empty texts: the bundle leaves out who she is. `last_word_height` is 0 if she never said more than by registering.
    """

    member: str
    handle: str
    role: str
    status: str
    proved_at_height: int
    last_word_height: int
    choices: list[ConsentDocument]
    history: list[ConsentWordDocument]


class SignedReceiptDocument(Document, frozen=True):
    """One consent receipt: what it says in `receipt` (fields of ISO/IEC TS 27560), who signed, and the notice it names.

    Both signed the bytes of `receipt` as JSON with sorted keys, without spaces, ASCII only. `notice_version` is 0 and
    `notice_hash` empty where no notice was in force.
    """

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
    """data/receipts.json: the consent receipts that the person's organisation and she herself signed."""

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
    """Return the one form in which a document is written: fields in order, indented by one, a line's end at the end."""
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def read_document(name: str, content: bytes, kind: type[D]) -> D:
    """Read a document from its one form. Raises BUNDLE_INVALID."""
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
    """Return the JSON Schema (2020-12) of a version's documents: `$defs` by type, `x-files` says which file has which."""
    documents = DOCUMENTS if version == FORMAT_VERSION else DOCUMENTS_EXTENDED
    kinds = [kind for _, kind in documents]
    _, components = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{FORMAT}, version {version}",
        "x-files": {name: {"$ref": f"#/$defs/{kind.__name__}"} for name, kind in documents},
        "$defs": dict(sorted(components.items())),
    }
