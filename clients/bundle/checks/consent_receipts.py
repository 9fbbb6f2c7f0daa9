"""Consent receipts in a file, and their offline check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain, ProvedValue
from clients.sdk.new_files import read_given_file
from consensus.bounded_text import TextInvalidError, read_json_as, read_json_text
from consensus.chain.genesis import Genesis, genesis_from_json, genesis_to_json
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.rights.consent_receipts import (
    ConsentStatement,
    build_document,
    is_notice_of,
    read_statement,
    require_signatures,
)
from consensus.rights.notices import PublishedNotice, read_published, read_row
from consensus.state.consent import NOTICE_TEXT
from consensus.state.identity import CUSTODIAN, MEMBER

FORMAT = "blockrobot-consent-receipts"
FORMAT_VERSION = 1
FILE_MAX_BYTES = 64 * 1024 * 1024
RECEIPTS_MAX_COUNT = 4_096
_NAME = "a consent receipt"
_VERSIONS_END = (1 << 32) - 1  # the next version has a key too
_FORM_ERRORS = (KeyError, TypeError, AttributeError, ValueError, IndexError, OverflowError, RecursionError)


class ReceiptFile(doc.Document, frozen=True):
    """One person's consent receipts on one chain."""

    format: str
    version: int
    genesis: str
    epochs: list[str]
    receipts: list[doc.ReceiptEntry]


@dataclass(frozen=True, slots=True)
class CheckedReceipt:
    """A checked receipt; `is_registrars`: signed by the proved registrar."""

    statement: ConsentStatement
    organisation: str
    node: str
    published: PublishedNotice | None
    fields: dict[str, Any]
    is_registrars: bool


def state_keys(controller_key: bytes, member: bytes, organisation: str, notice_version: int) -> list[bytes]:
    """Return a receipt's proof keys: node, person, notice versions."""
    versions = [notice_version, notice_version + 1] if notice_version else [1]
    keys = [CUSTODIAN.key(controller_key), MEMBER.key(member)]
    return [*keys, *(NOTICE_TEXT.key(version, organisation) for version in versions)]


def read_reference(document: bytes) -> tuple[str, int]:
    """Return organisation and notice version (0: none). Raises CONSENT_RECEIPT_INVALID."""
    try:
        fields = read_json_text(document)
        notice = fields["privacy_notice"]
        organisation, version = fields["pii_controllers"][0]["party_id"], 0 if notice is None else notice["version"]
        organisation.encode()  # as a key of the state: no text with half a character
    except (*_FORM_ERRORS, UnicodeDecodeError):
        organisation, version = None, None
    if not isinstance(organisation, str) or type(version) is not int or not 0 <= version < _VERSIONS_END:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "It has not the form of a consent receipt.")
    return organisation, version


def check_entry(
    chain: ProvedChain, genesis: Genesis, entry: doc.ReceiptEntry, *, signed: bool = True
) -> CheckedReceipt:
    """`signed` False: the person's signature is pending. Raises CONSENT_RECEIPT_INVALID."""
    try:
        return _check(chain, genesis, entry, signed=signed)
    except BlockRobotError as error:
        if error.code == "CONSENT_RECEIPT_INVALID":
            raise
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", f"{error.detail} ({error.code})") from None
    except _FORM_ERRORS as error:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", f"It has an unknown form ({error!r:.80}).") from None


def _check(chain: ProvedChain, genesis: Genesis, entry: doc.ReceiptEntry, *, signed: bool) -> CheckedReceipt:
    document = entry.document.encode()
    transaction = decode_transaction(doc.read_bytes(_NAME, entry.transaction))
    transaction.verify_sender()
    if transaction.body.chain_id != genesis.chain_id:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "It is of another chain.")
    proved = chain.receipt(_NAME, entry.proof)
    statement = read_statement(
        transaction, proved.receipt, height=proved.height, index=proved.index, time_ms=proved.time_ms
    )
    key = doc.read_bytes(_NAME, entry.controller_key)
    state = chain.state(_NAME, entry.state)
    value = state[CUSTODIAN.key(key)].value
    if value is None:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "Who signed it is no custodian of the network.")
    node, (organisation, version) = CUSTODIAN.convert(value), read_reference(document)
    if organisation != node.org:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", f"A node of {node.org} signed it for {organisation}.")
    is_registrars = _is_registrars(state, organisation, statement)
    published = _notice(state, organisation, version, statement)
    if build_document(statement, organisation, published) != document:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "Its words are not those of the chain.")
    require_signatures(
        document,
        controller=key,
        controller_signature=doc.read_bytes(_NAME, entry.controller_signature),
        person=statement.member,
        person_signature=doc.read_bytes(_NAME, entry.person_signature) if signed else None,
    )
    return CheckedReceipt(statement, organisation, node.name, published, read_json_text(document), is_registrars)


def _is_registrars(state: dict[bytes, ProvedValue], organisation: str, statement: ConsentStatement) -> bool:
    """Raises CONSENT_RECEIPT_INVALID."""
    proved = state.get(MEMBER.key(statement.member))
    if proved is None:
        return False
    row = None if proved.value is None else MEMBER.convert(proved.value)
    if row is None or (row.org, row.handle) != (organisation, statement.handle):
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", f"{organisation} signed it, and did not register the owner.")
    return True


def _notice(
    state: dict[bytes, ProvedValue], organisation: str, version: int, statement: ConsentStatement
) -> PublishedNotice | None:
    following = state[NOTICE_TEXT.key(version + 1, organisation)]
    if following.height < statement.height:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "What proves its notice is older than the word itself.")
    published = None
    if version:
        published = read_published(organisation, state[NOTICE_TEXT.key(version, organisation)].value)
    row = None if published is None else published.row
    known = published is not None or version == 0
    if not known or not is_notice_of(row, read_row(organisation, following.value), statement):
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "Another notice was in force when the owner spoke.")
    return published


def encode_file(genesis: Genesis, epochs: Sequence[str], entries: Sequence[doc.ReceiptEntry]) -> bytes:
    content = ReceiptFile(FORMAT, FORMAT_VERSION, genesis_to_json(genesis), list(epochs), list(entries))
    return msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"


def is_receipt_file(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(64).lstrip().startswith(b"{")


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """A sound file's receipts; `is_anchored`: against the reader's genesis."""

    genesis: Genesis
    is_anchored: bool
    receipts: tuple[CheckedReceipt, ...]


def check_file(path: Path, expected: Genesis | bytes | None = None) -> CheckedFile:
    """Raises RECEIPT_FILE_DAMAGED, CONSENT_RECEIPT_INVALID, BUNDLE_OTHER_CHAIN."""
    try:
        content = read_json_as(read_given_file(path, FILE_MAX_BYTES), ReceiptFile)
        genesis = genesis_from_json(content.genesis)
        chain = ProvedChain(genesis, content.epochs)
    except TextInvalidError:
        raise BlockRobotError("RECEIPT_FILE_DAMAGED", f"{path} is no file of consent receipts, or not whole.") from None
    except BlockRobotError as error:
        raise BlockRobotError("RECEIPT_FILE_DAMAGED", f"{error.detail} ({error.code})") from None
    wanted = expected.block_id if isinstance(expected, Genesis) else expected
    if wanted is not None and wanted != genesis.block_id:
        raise BlockRobotError("BUNDLE_OTHER_CHAIN", "The receipts are of another network than the one you named.")
    if (content.format, content.version) != (FORMAT, FORMAT_VERSION) or len(content.receipts) > RECEIPTS_MAX_COUNT:
        raise BlockRobotError("RECEIPT_FILE_DAMAGED", f"{path} has a form that this version does not know.")
    if not content.receipts:
        raise BlockRobotError("RECEIPT_FILE_DAMAGED", f"{path} holds no receipt: it proves nothing.")
    checked = tuple(check_entry(chain, genesis, entry) for entry in content.receipts)
    if len({each.statement.txid for each in checked}) < len(checked):
        raise BlockRobotError("RECEIPT_FILE_DAMAGED", "The file holds a receipt twice.")
    if len({each.statement.handle for each in checked}) > 1:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "The file mixes receipts of several persons.")
    return CheckedFile(genesis, wanted is not None, checked)
