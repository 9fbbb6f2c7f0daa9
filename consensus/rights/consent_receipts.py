"""Consent receipts, reproducible from the chain byte for byte; names of ISO/IEC TS 27560:2023."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from consensus.chain.block import Receipt
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey, verify
from consensus.rights.notices import Notice, NoticeVersion, Party, PublishedNotice
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.state.consent import GIVEN

RECEIPT_SCHEMA = "ISO/IEC TS 27560:2023 (blockrobot-consent-receipt-1)"
CONTROLLER_TAG = "blockrobot/consent-receipt"
PERSON_TAG = "blockrobot/consent-receipt-person"
REFUSED = "refused"
WITHDRAWN = "withdrawn"
FIRST_SENSORS = ("depth",)
"""What registering consents to, as the contract `consent` writes it."""
_STATUS_OF = {"give": GIVEN, "refuse": REFUSED, "withdraw": WITHDRAWN}
_GIVE_ARGUMENTS_COUNT = 7
_SAY_NO_ARGUMENTS_COUNT = 3
_REGISTER_ARGUMENTS_COUNT = 10


@dataclass(frozen=True, slots=True)
class ConsentStatement:
    """One consent statement; times in ms, 0 is unbounded.

    `seen_height` decides which notice applied; empty lists in a refusal mean all.
    """

    chain_id: bytes
    txid: bytes
    member: bytes
    handle: bytes
    status: str
    purposes: tuple[str, ...]
    sensors: tuple[str, ...]
    from_ms: int
    until_ms: int
    height: int
    index: int
    time_ms: int
    from_height: int
    seen_height: int


def _invalid(detail: str) -> BlockRobotError:
    return BlockRobotError("CONSENT_RECEIPT_INVALID", detail)


def read_statement(
    transaction: Transaction, receipt: Receipt, *, height: int, index: int, time_ms: int
) -> ConsentStatement:
    """Return the statement of a proven transaction. Raises CONSENT_RECEIPT_INVALID (refused), CONSENT_WORD_MISSING."""
    if receipt.txid != transaction.txid or not receipt.ok:
        raise _invalid("The transaction is another one, or the chain refused it.")
    body, arguments = transaction.body, transaction.arguments()
    place = (body.contract, body.entry)
    if place == ("identity", "register") and len(arguments) == _REGISTER_ARGUMENTS_COUNT and arguments[9]:
        status, values = GIVEN, (arguments[0], arguments[9], list(FIRST_SENSORS), 0, 0, height + 1, height - 1)
    elif body.contract == "consent" and body.entry in _STATUS_OF:
        status = _STATUS_OF[body.entry]
        values = _read_values(body.entry, arguments, _from_height(receipt, status), height)
    else:
        raise BlockRobotError("CONSENT_WORD_MISSING")
    handle, purposes, sensors, from_ms, until_ms, from_height, seen_height = values
    return ConsentStatement(
        chain_id=body.chain_id,
        txid=transaction.txid,
        member=body.sender,
        handle=handle,
        status=status,
        purposes=tuple(purposes),
        sensors=tuple(sensors),
        from_ms=from_ms,
        until_ms=until_ms,
        height=height,
        index=index,
        time_ms=time_ms,
        from_height=from_height,
        seen_height=seen_height,
    )


def _read_values(entry: str, arguments: list[Any], from_height: int, height: int) -> tuple[Any, ...]:
    if entry == "give" and len(arguments) == _GIVE_ARGUMENTS_COUNT:
        return (*arguments[:5], from_height, arguments[6])
    if entry != "give" and len(arguments) == _SAY_NO_ARGUMENTS_COUNT:
        return (*arguments, 0, 0, from_height, height - 1)
    raise _invalid("The word of consent has another form than this version knows.")


def _from_height(receipt: Receipt, status: str) -> int:
    for event in receipt.events:
        if (event.contract, event.name) == ("consent", status):
            fields = decode_value(event.data)
            if fields["mandate"]:
                raise BlockRobotError("CONSENT_WORD_MISSING", "It was said for another person, under a mandate.")
            return int(fields["height"])
    raise _invalid("The chain does not tell from when the word holds.")


def is_notice_of(row: NoticeVersion | None, following: NoticeVersion | None, statement: ConsentStatement) -> bool:
    """Return whether a version was in force; `row` None: there was none, `following` the first or None."""
    come = row is None or row.height <= statement.seen_height
    return come and (following is None or following.height > statement.seen_height)


def build_document(statement: ConsentStatement, organisation: str, published: PublishedNotice | None) -> bytes:
    """Return receipt JSON: sorted keys, no spaces, ASCII only."""
    notice = None if published is None else published.notice
    fields: dict[str, Any] = {
        "schema_version": RECEIPT_SCHEMA,
        "record_id": statement.txid.hex(),
        "pii_principal_id": statement.handle.hex(),
        "pii_principal_key": statement.member.hex(),
        "pii_controllers": _controllers(organisation, notice),
        "privacy_notice": None if published is None else _notice_reference(published.row),
        "language": "en" if notice is None else notice.language,
        "purposes": [_purpose(code, notice) for code in statement.purposes],
        "purposes_scope": "named" if statement.purposes else "every purpose for which consent had been given",
        "pii_information": [{"pii_type": code, "words": SENSORS.get(code, code)} for code in statement.sensors],
        "pii_scope": "named" if statement.sensors else "every sensor",
        "collection_method": "by a robot that meets the person, as their tag tells",
        "events": [_event(statement)],
        "chain": {
            "chain_id": statement.chain_id.hex(),
            "height": statement.height,
            "index": statement.index,
            "txid": statement.txid.hex(),
        },
    }
    if notice is not None:
        fields |= _of_notice(notice)
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def _controllers(organisation: str, notice: Notice | None) -> list[dict[str, str]]:
    own = {"party_id": organisation, "party_role": "controller"}
    if notice is None:
        return [own]
    joint = [_party(party) | {"party_role": "joint controller"} for party in notice.joint_controllers]
    officer = _party(notice.officer) | {"party_role": "data protection officer"}
    return [own | _party(notice.controller), *joint, officer]


def _party(party: Party) -> dict[str, str]:
    return {"party_name": party.name, "party_address": party.address, "party_contact": party.contact}


def _notice_reference(row: NoticeVersion) -> dict[str, Any]:
    return {
        "reference": f"{row.organisation}, version {row.version}",
        "organisation": row.organisation,
        "version": row.version,
        "hash": row.digest.hex(),
        "published_at_ms": row.time_ms,
    }


def _purpose(code: str, notice: Notice | None) -> dict[str, Any]:
    fields = {"purpose": code, "purpose_words": PURPOSES.get(code, code), "lawful_basis": "consent"}
    found = next((each for each in notice.purposes if each.code == code), None) if notice is not None else None
    if found is None:
        return fields
    period = f"{found.storage_days} days"
    bases = {"lawful_basis": found.lawful_basis, "special_category_basis": found.special_basis}
    return fields | bases | {"purpose_words": found.words, "storage_period": period}


def _event(statement: ConsentStatement) -> dict[str, Any]:
    period = {"from_ms": statement.from_ms or None, "until_ms": statement.until_ms or None}
    return {
        "event_id": statement.txid.hex(),
        "event_time_ms": statement.time_ms,
        "event_type": "explicit",
        "event_state": statement.status,
        "entity_id": statement.handle.hex(),
        "effective_from_height": statement.from_height,
        "validity": period,
    }


def _of_notice(notice: Notice) -> dict[str, Any]:
    builtins: Mapping[str, Any] = msgspec.to_builtins(notice)
    return {
        "jurisdiction": notice.jurisdiction,
        "retention_period": builtins["retention"],
        "recipient_third_parties": builtins["recipients"],
        "third_countries": notice.third_countries,
        "withdrawal_method": notice.withdrawal,
        "privacy_rights": builtins["rights"],
        "authority_party": _party(notice.authority),
        "automated_decisions": notice.automated_decisions,
    }


def sign_as_controller(key: PrivateKey, document: bytes) -> bytes:
    return key.sign_compact(CONTROLLER_TAG, document)


def sign_as_person(key: PrivateKey, document: bytes, controller_signature: bytes) -> bytes:
    return key.sign_compact(PERSON_TAG, document, controller_signature)


def require_signatures(
    document: bytes, *, controller: bytes, controller_signature: bytes, person: bytes, person_signature: bytes | None
) -> None:
    """Raise CONSENT_RECEIPT_INVALID unless both signed (None: person not yet)."""
    if not verify(controller, CONTROLLER_TAG, controller_signature, document):
        raise _invalid("The organisation's node did not sign it.")
    if person_signature is None:
        return
    if not verify(person, PERSON_TAG, person_signature, document, controller_signature):
        raise _invalid("The person whose word it is did not sign it.")
