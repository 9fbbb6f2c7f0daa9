"""The exact row form that the machine accepts as contract changes.

Other forms are ignored; the machine's own tables are beyond every contract's reach.
"""

from __future__ import annotations

import re
from typing import Any, TypeGuard

from consensus.primitives.encoding import decode_value
from consensus.state.keys import Reader
from consensus.state.lifecycle import DUE, MACHINE, MACHINE_TRIALS, VERSION

GOVERNING = (
    "access",
    "audit",
    "consent",
    "erasure",
    "forms",
    "identity",
    "lifecycle",
    "mandates",
    "membership",
    "officers",
    "producers",
    "records",
    "rights",
    "settings",
)
TRIAL_MS = 24 * 3600 * 1000
_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)
_KINDS = ("activate", "disable", "keep")
_HASH_BYTES = 32
_VERSION_MAX = 0xFFFF_FFFF
_COUNT_BEYOND = 1 << 53
_RECORD_FIELDS = {
    "size_bytes": int,
    "migrates": bool,
    "note": str,
    "organisation": str,
    "proposal_id": bytes,
    "approved_height": int,
    "status": str,
    "since_height": int,
    "failure": str,
}

Row = dict[str, Any]


def read_value(state: Reader, key: bytes) -> Any:
    data = state.get(key)
    return None if data is None else decode_value(data)


def is_count(value: object) -> TypeGuard[int]:
    """Whether it is an integer from 0 exact in JSON; booleans are not."""
    return type(value) is int and 0 <= value < _COUNT_BEYOND


def _is_hash(value: object) -> bool:
    return isinstance(value, bytes) and len(value) == _HASH_BYTES


def is_change(row: object) -> bool:
    """Whether it is {kind, name, version, from_height, from_ms}; extra fields are ignored."""
    if not isinstance(row, dict) or row.get("kind") not in _KINDS:
        return False
    name, version = row.get("name"), row.get("version")
    known = isinstance(name, str) and _NAME.fullmatch(name) is not None and name != MACHINE
    if not known or not is_count(version) or not 0 < version <= _VERSION_MAX:
        return False
    return is_count(row.get("from_height")) and is_count(row.get("from_ms"))


def changes_in(value: object) -> list[Row]:
    return [row for row in value if is_change(row)] if isinstance(value, list) else []


def read_due(state: Reader) -> list[Row]:
    return changes_in(read_value(state, DUE.flat))


def read_trials(state: Reader) -> list[Row]:
    """Return the trials: {kind: "return", name, version, source_hash, from_height, from_ms}.

    `version` is the one restored at `from_ms`.
    """
    return read_value(state, MACHINE_TRIALS.flat) or []


def read_record(state: Reader, name: str, version: int) -> Row | None:
    """Return a version's `lifecycle` record, or None if it names no source."""
    record = read_value(state, VERSION.key(name, version))
    return record if isinstance(record, dict) and _is_hash(record.get("source_hash")) else None


def is_full_record(record: object) -> bool:
    if not isinstance(record, dict) or not _is_hash(record.get("source_hash")):
        return False
    if not all(type(record.get(field)) is kind for field, kind in _RECORD_FIELDS.items()):
        return False
    entries = record.get("entries")
    return isinstance(entries, list) and all(_is_entry(entry) for entry in entries)


def _is_entry(entry: object) -> bool:
    """Form: [name, kind, parameters, required count, result type]."""
    if not isinstance(entry, list) or len(entry) != 5:
        return False
    name, kind, params, required, returns = entry
    known = all(isinstance(text, str) for text in (name, kind, returns)) and is_count(required)
    return known and isinstance(params, list) and all(_is_parameter(param) for param in params)


def _is_parameter(param: object) -> bool:
    return isinstance(param, list) and len(param) == 2 and all(isinstance(text, str) for text in param)
