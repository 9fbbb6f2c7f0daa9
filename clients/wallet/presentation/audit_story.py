"""Audit events by kind, actor and sentence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clients.sdk.terminal.json_answers import Answer, Hex
from clients.wallet.ledger.visit_audit import AuditEntry
from clients.wallet.presentation.translations import code_text, purposes_text, text
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE, load

_BY_ROBOT = frozenset({"visit_opened", "recorded", "visit_closed"})
_BY_CUSTODIAN = frozenset({"access_released", "access_refused", "erasure_receipted", "expired"})
_BY_OFFICERS = frozenset({"breach_assessed", "breach_notified", "breach_closed", "erased_by_officers"})
_TONES = {
    "access_refused": "warn",
    "denied": "warn",
    "erased_by_officers": "warn",
    "erasure_complete": "good",
    "grant_noticed": "good",
}


class PageEvent(Answer, frozen=True, kw_only=True):
    """An event of the audit."""

    visit: Hex
    record_id: Hex | None
    kind: str
    time_ms: int
    height: int
    index: int
    data: Mapping[str, Any]
    sentence: str
    tone: str
    who: str


def page_event(entry: AuditEntry, names: Mapping[bytes, str], language: str) -> PageEvent:
    """`names` are custodians' by key."""
    data = _named(entry, names, language)
    return PageEvent(
        visit=entry.owner.hex(),
        record_id=entry.record_id.hex() or None,
        kind=entry.kind,
        time_ms=entry.time_ms,
        height=entry.height,
        index=entry.index,
        data=data,
        sentence=_sentence(entry, data, language),
        tone=_tone(entry),
        who=_who(entry),
    )


def event_sentence(entry: AuditEntry, names: Mapping[bytes, str], language: str) -> str:
    return _sentence(entry, _named(entry, names, language), language)


def _named(entry: AuditEntry, names: Mapping[bytes, str], language: str) -> Mapping[str, Any]:
    data = {name: plain(value) for name, value in entry.data.items()}
    custodian = entry.data.get("custodian")
    if isinstance(custodian, bytes):
        unnamed = text("custodian.unnamed", language=language, key=custodian.hex()[:12])
        data["custodian_name"] = names.get(custodian, unnamed)
    return data


def plain(value: Any) -> Any:
    """As JSON, bytes in hex."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, dict):
        return {plain(key) if isinstance(key, bytes) else str(key): plain(each) for key, each in value.items()}
    return value


def _who(entry: AuditEntry) -> str:
    if entry.kind in _BY_ROBOT:
        return "robot"
    if entry.kind in _BY_CUSTODIAN:
        return "custodian"
    if entry.kind in _BY_OFFICERS:
        return "officers"
    if entry.kind == "grant_noticed" or (entry.kind == "access_requested" and "grant" in entry.data):
        return "other"
    return "network" if entry.kind == "erasure_complete" else "you"


def _tone(entry: AuditEntry) -> str:
    if entry.kind == "verdict":
        return "good" if entry.data.get("verdict") == "verified" else "bad"
    return _TONES.get(entry.kind, "quiet")


def _variant(entry: AuditEntry) -> str:
    if entry.kind == "verdict":
        return f"verdict_{entry.data.get('verdict')}"
    if entry.kind == "access_requested":
        own = "" if entry.data.get("records") else "_meeting"
        return entry.kind + ("_shared" if "grant" in entry.data else own)
    if entry.kind == "erasure_requested" and entry.data.get("frames"):
        return "erasure_requested_frames"
    return entry.kind


def _sentence(entry: AuditEntry, data: Mapping[str, Any], language: str) -> str:
    findings = data.get("findings", [])
    counted = data.get("destroyed_frames", data.get("records", data.get("record_count", findings)))
    values = {
        **data,
        "count": len(counted) if isinstance(counted, list) else counted,
        "changed": sum(finding[1] == "corrupted" for finding in findings),
        "custodian": data.get("custodian_name", ""),
        "purposes": purposes_text(data.get("purposes", []), language=language),
    }
    if "purpose" in data:
        values["purpose"] = code_text("purpose", data["purpose"], language=language)
    try:
        return text(f"page.story.{_variant(entry)}", language=language, **values)
    except (KeyError, TypeError, IndexError):
        words = describe_event(entry.kind, entry.data, language)
        kind = code_text("kind", entry.kind, language=language).replace("_", " ")
        return f"{kind}: {words}" if words else kind


def describe_event(kind: str, data: dict[str, Any], language: str | None = None) -> str:
    """An audit entry's details, or empty. `language` None: the current one."""
    key = f"audit.said.{kind}"
    if key not in load(DEFAULT_LANGUAGE) or (kind == "access_requested" and "grant" not in data):
        return ""
    words = text(key, language=language, **_values_of(kind, data, language))
    more = {"restricted": ("until_ms", "kept"), "breach_notified": ("late", "late")}.get(kind)
    return words + text(f"audit.said.{more[1]}", language=language) if more and data[more[0]] else words


def _values_of(kind: str, data: dict[str, Any], language: str | None) -> dict[str, object]:
    values: dict[str, object] = dict(data)
    for name in ("ground", "purpose", "reason", "risk", "recipient", "outcome"):
        if name in data:
            values[name] = code_text(name, data[name], language=language)
    for name in ("breach_id", "grant_id", "grant"):
        if name in data:
            values["name"] = data[name].hex()[:12]
    if kind == "objected":
        values["purposes"] = purposes_text(data["purposes"], language=language)
    if kind == "corrected":
        values |= {"number": data["number"] + 1, "kind": code_text("correction", data["kind"], language=language)}
    records = data.get("records")
    return values | {"count": len(records) if isinstance(records, list) else records}
