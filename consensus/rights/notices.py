"""Versioned privacy notices as canonical JSON (sorted keys, no spaces), hashed in contract `consent`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.visible_text import find_hidden, one_entry, split_lines

NOTICE_TAG = "blockrobot/notice"
NOTICE_SCHEMA = "blockrobot-notice-1"
NOTICE_MAX_BYTES = 14_000
TEXT_MAX_CHARS = 1_200
ITEMS_MAX_COUNT = 32
SOURCES = ("robot", "registrar", "yourself", "network")
LAWFUL_BASES = tuple(f"Art. 6(1)({letter})" for letter in "abcdef")
SPECIAL_BASES = ("none", *(f"Art. 9(2)({letter})" for letter in "abcdefghij"))
CONSENT_BASIS = "Art. 6(1)(a)"
EXPLICIT_CONSENT_BASIS = "Art. 9(2)(a)"
RIGHTS_NAMED = ("15", "16", "17", "18", "20", "21", "7(3)", "77")
"""The rights that every notice names, by article: Art. 13(2)(b) to (d)."""


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every part of a notice."""


class Party(_Part, frozen=True):
    """A controller, data protection officer or authority, with contact."""

    name: str
    address: str
    contact: str


class NoticePurpose(_Part, frozen=True):
    """A purpose: code, text, grounds (Art. 6 and 9), sensors and retention."""

    code: str
    words: str
    lawful_basis: str
    special_basis: str
    sensors: list[str]
    storage_days: int

    @property
    def rests_on_consent(self) -> bool:
        """Return whether consent is asked: Art. 6, or Art. 9 beside another ground."""
        return self.lawful_basis == CONSENT_BASIS or self.special_basis == EXPLICIT_CONSENT_BASIS


class Category(_Part, frozen=True):
    """A data category: description, source (of `SOURCES`) and source's name."""

    what: str
    source: str
    origin: str


class Recipient(_Part, frozen=True):
    """Who gets which data, and why."""

    who: str
    what: str
    why: str


class Retention(_Part, frozen=True):
    """How long something is kept."""

    what: str
    how_long: str


class Right(_Part, frozen=True):
    """A right by its article (`15`), in plain words, and how to use it."""

    article: str
    words: str
    how: str


class Notice(_Part, frozen=True):
    """A notice; all fields are required, `joint_controllers` may be empty."""

    schema: str
    language: str
    controller: Party
    joint_controllers: list[Party]
    officer: Party
    purposes: list[NoticePurpose]
    categories: list[Category]
    recipients: list[Recipient]
    retention: list[Retention]
    third_countries: str
    jurisdiction: str
    rights: list[Right]
    withdrawal: str
    authority: Party
    obligation: str
    automated_decisions: str
    measures: list[str]


@dataclass(frozen=True, slots=True)
class NoticeVersion:
    """A version on the chain: number from 1, hash and block."""

    organisation: str
    version: int
    digest: bytes
    height: int
    time_ms: int


@dataclass(frozen=True, slots=True)
class PublishedNotice:
    """A version with text matching its hash."""

    row: NoticeVersion
    notice: Notice


def notice_digest(document: bytes) -> bytes:
    return tagged_hash(NOTICE_TAG, document)


def encode_notice(notice: Notice) -> bytes:
    """Raises NOTICE_INVALID if incomplete or too long."""
    check_notice(notice)
    document = msgspec.json.encode(notice, order="sorted")
    if len(document) > NOTICE_MAX_BYTES:
        raise BlockRobotError("NOTICE_INVALID", f"It has {len(document)} bytes; {NOTICE_MAX_BYTES} are the most.")
    return document


def decode_notice(document: bytes) -> Notice:
    """Raises NOTICE_INVALID unless complete and canonical."""
    try:
        notice = read_json_as(document, Notice)
    except TextInvalidError as error:
        raise BlockRobotError("NOTICE_INVALID", f"It has not the form of a notice: {error}.") from None
    if encode_notice(notice) != document:
        raise BlockRobotError("NOTICE_INVALID", "It is not written in its one form.")
    return notice


def notice_from(values: Mapping[str, Any]) -> Notice:
    """From TOML-like values. Raises NOTICE_INVALID."""
    try:
        notice = msgspec.convert({"schema": NOTICE_SCHEMA, "joint_controllers": [], **values}, Notice)
    except msgspec.ValidationError as error:
        raise BlockRobotError("NOTICE_INVALID", f"{error}.") from None
    check_notice(notice)
    return notice


def check_notice(notice: Notice) -> None:
    """Raise NOTICE_INVALID unless complete by Art. 13 and 14, and printable."""
    for place, text in _texts(msgspec.to_builtins(notice)):
        if not text.strip() or len(text) > TEXT_MAX_CHARS or next(find_hidden(text, "\n"), None) is not None:
            raise BlockRobotError("NOTICE_INVALID", f"{place} is empty, too long or holds what cannot be shown.")
    lists = (notice.purposes, notice.categories, notice.recipients, notice.retention, notice.rights, notice.measures)
    if any(not 1 <= len(each) <= ITEMS_MAX_COUNT for each in lists):
        raise BlockRobotError("NOTICE_INVALID", f"Each list has between 1 and {ITEMS_MAX_COUNT} entries.")
    if notice.schema != NOTICE_SCHEMA:
        raise BlockRobotError("NOTICE_INVALID", f"Its schema is not {NOTICE_SCHEMA}.")
    codes = [purpose.code for purpose in notice.purposes]
    if len(set(codes)) != len(codes):
        raise BlockRobotError("NOTICE_INVALID", "A purpose stands in it twice.")
    for purpose in notice.purposes:
        _check_purpose(purpose)
    for category in notice.categories:
        if category.source not in SOURCES:
            raise BlockRobotError("NOTICE_INVALID", f"{category.source!r} is no source: {', '.join(SOURCES)}.")
    missing = [article for article in RIGHTS_NAMED if article not in {right.article for right in notice.rights}]
    if missing:
        raise BlockRobotError("NOTICE_INVALID", f"It does not name the rights of Art. {', '.join(missing)}.")
    if not any(category.source == "registrar" for category in notice.categories):
        raise BlockRobotError("NOTICE_INVALID", "It does not say what comes from the registrar (Art. 14).")


def _check_purpose(purpose: NoticePurpose) -> None:
    faults = [
        (purpose.code not in PURPOSES, f"{purpose.code!r} is no published purpose"),
        (purpose.lawful_basis not in LAWFUL_BASES, f"{purpose.lawful_basis!r} is no basis of Art. 6"),
        (purpose.special_basis not in SPECIAL_BASES, f"{purpose.special_basis!r} is no basis of Art. 9"),
        (not set(purpose.sensors) <= set(SENSORS), f"{purpose.code} names a sensor that there is not"),
        (not 0 <= purpose.storage_days <= 366, f"{purpose.code} is kept for no number of days up to 366"),
    ]
    for is_so, sentence in faults:
        if is_so:
            raise BlockRobotError("NOTICE_INVALID", f"{sentence}.")


def _texts(value: Any, place: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield place, value
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _texts(part, f"{place}.{name}" if place else name)
    elif isinstance(value, list):
        for number, part in enumerate(value, 1):
            yield from _texts(part, f"{place} {number}")


def read_row(organisation: str, value: Any) -> NoticeVersion | None:
    """None if absent. Raises NOTICE_INVALID."""
    if value is None:
        return None
    try:
        row = NoticeVersion(organisation, value["version"], value["hash"], value["height"], value["time"])
    except (KeyError, TypeError, IndexError):
        row = None
    if row is None or [type(part) for part in (row.version, row.digest, row.height, row.time_ms)] != _ROW_TYPES:
        raise BlockRobotError("NOTICE_INVALID", "The chain holds it in a form that this version does not know.")
    return row


_ROW_TYPES = [int, bytes, int, int]


def read_published(organisation: str, value: Any) -> PublishedNotice | None:
    """None if absent. Raises NOTICE_INVALID."""
    row = read_row(organisation, value)
    if row is None:
        return None
    document = value.get("document")
    if not isinstance(document, bytes) or notice_digest(document) != row.digest:
        raise BlockRobotError("NOTICE_INVALID", "Its words do not have the hash that the chain names.")
    return PublishedNotice(row, decode_notice(document))


def askable_pairs(notice: Notice) -> dict[str, list[str]]:
    return {each.code: sorted(each.sensors) for each in notice.purposes if each.rests_on_consent}


def require_consent_asked(published: PublishedNotice, purposes: Sequence[str], sensors: Sequence[str]) -> None:
    """Check that consent is possible for these purposes and sensors. Refusals need no check.

    Raises PURPOSE_NOT_IN_NOTICE, CONSENT_NOT_ASKED (other ground), SENSOR_NOT_IN_NOTICE.
    """
    named = {each.code: each for each in published.notice.purposes}
    notice_name = f"The notice of {published.row.organisation} (version {published.row.version})"
    missing = ", ".join(repr(code) for code in purposes if code not in named)
    if missing:
        raise BlockRobotError(
            "PURPOSE_NOT_IN_NOTICE", f"{notice_name} does not name {missing}. It names: {', '.join(named)}."
        )
    for purpose in (named[code] for code in purposes):
        if not purpose.rests_on_consent:
            detail = f"{notice_name} rests {purpose.code!r} on {purpose.lawful_basis} GDPR, not on consent."
            raise BlockRobotError("CONSENT_NOT_ASKED", detail)
        beyond = ", ".join(repr(code) for code in sensors if code not in purpose.sensors)
        if beyond:
            known = ", ".join(purpose.sensors) or "no sensor"
            raise BlockRobotError(
                "SENSOR_NOT_IN_NOTICE", f"{notice_name} names for {purpose.code!r}: {known}. Not: {beyond}."
            )


NOTICE_LINES: Mapping[str, str] = {
    "controller": "Responsible: {party}",
    "joint_controller": "Responsible together with: {party}",
    "officer": "Data protection officer: {party}",
    "purpose": "Purpose {code}: {words} Ground: {basis}{special} GDPR{sensors}{kept}.",
    "special": " and {special}",
    "sensors": ", by {sensors}",
    "kept": ", kept {days} days",
    "data": "Data: {what} From: {origin}",
    "recipient": "Who gets it: {who}: {what} Why: {why}",
    "retention": "How long: {what}: {how_long}",
    "countries": "Other countries: {words}",
    "law": "Law: {words}",
    "right": "Your right (Art. {article}): {words} How: {how}",
    "withdrawal": "Taking consent back: {words}",
    "authority": "Complaints: {party}",
    "obligation": "Do you have to: {words}",
    "automated": "Automated decisions: {words}",
    "protection": "Protection: {words}",
}
"""What stands before the words of a notice where people read it: no part of what was published."""


def notice_lines(notice: Notice, labels: Mapping[str, str] = NOTICE_LINES) -> list[str]:
    """Return entries in order of Art. 13 and 14; continuation lines are marked, preventing forged entries."""
    return [entry for topic in _topics(notice, labels) for entry in topic]


def _topics(notice: Notice, labels: Mapping[str, str]) -> list[list[str]]:
    topics = [
        [labels["controller"].format(party=_party(notice.controller))],
        [labels["joint_controller"].format(party=_party(party)) for party in notice.joint_controllers],
        [labels["officer"].format(party=_party(notice.officer))],
        [_purpose_line(purpose, labels) for purpose in notice.purposes],
        [labels["data"].format(what=each.what, origin=each.origin) for each in notice.categories],
        [labels["recipient"].format(who=each.who, what=each.what, why=each.why) for each in notice.recipients],
        [labels["retention"].format(what=each.what, how_long=each.how_long) for each in notice.retention],
        [labels["countries"].format(words=notice.third_countries)],
        [labels["law"].format(words=notice.jurisdiction)],
        [labels["right"].format(article=each.article, words=each.words, how=each.how) for each in notice.rights],
        [labels["withdrawal"].format(words=notice.withdrawal)],
        [labels["authority"].format(party=_party(notice.authority))],
        [labels["obligation"].format(words=notice.obligation)],
        [labels["automated"].format(words=notice.automated_decisions)],
        [labels["protection"].format(words=measure) for measure in notice.measures],
    ]
    return [[one_entry(entry) for entry in topic] for topic in topics]


def _purpose_line(purpose: NoticePurpose, labels: Mapping[str, str]) -> str:
    return labels["purpose"].format(
        code=purpose.code,
        words=purpose.words,
        basis=purpose.lawful_basis,
        special="" if purpose.special_basis == "none" else labels["special"].format(special=purpose.special_basis),
        sensors=labels["sensors"].format(sensors=", ".join(purpose.sensors)) if purpose.sensors else "",
        kept=labels["kept"].format(days=purpose.storage_days) if purpose.storage_days else "",
    )


def _party(party: Party) -> str:
    return f"{party.name}, {party.address}, {party.contact}"


def change_lines(before: Notice, after: Notice) -> list[str]:
    """Return removed (`- `) and added (`+ `) entries by topic."""
    lines: list[str] = []
    for old, new in zip(_topics(before, NOTICE_LINES), _topics(after, NOTICE_LINES), strict=True):
        for mark, entries, others in (("- ", old, new), ("+ ", new, old)):
            left = Counter(entries) - Counter(others)
            for entry in entries:
                if left[entry] > 0:
                    left[entry] -= 1
                    lines += (f"{mark}{line}" for line in split_lines(entry))
    return lines
