"""What the machine takes for a change of contracts: rows of one exact form.

The contract `lifecycle` asks for changes under `due`, and any version of it may write there what it likes: a row of
another form is no row. What the machine decides by stands under keys of its own, which no contract reaches: the table
of the contracts in force, their sources, and the trials, each with the version that comes back when it ends.
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
    """Return the value under a flat key, or None."""
    data = state.get(key)
    return None if data is None else decode_value(data)


def is_count(value: object) -> TypeGuard[int]:
    """Whether a value is a whole number from 0 on that JSON holds exactly; True and False are none."""
    return type(value) is int and 0 <= value < _COUNT_BEYOND


def _is_hash(value: object) -> bool:
    return isinstance(value, bytes) and len(value) == _HASH_BYTES


def is_change(row: object) -> bool:
    """Whether a value is a change: {kind, name, version, from_height, from_ms}; other fields say nothing."""
    if not isinstance(row, dict) or row.get("kind") not in _KINDS:
        return False
    name, version = row.get("name"), row.get("version")
    known = isinstance(name, str) and _NAME.fullmatch(name) is not None and name != MACHINE
    if not known or not is_count(version) or not 0 < version <= _VERSION_MAX:
        return False
    return is_count(row.get("from_height")) and is_count(row.get("from_ms"))


def changes_in(value: object) -> list[Row]:
    """Return the changes in what stands under `due`, in its order; what has another form is left out."""
    return [row for row in value if is_change(row)] if isinstance(value, list) else []


def read_due(state: Reader) -> list[Row]:
    """Return what the contract `lifecycle` asks for."""
    return changes_in(read_value(state, DUE.flat))


def read_trials(state: Reader) -> list[Row]:
    """Return the trials, as the machine wrote them: {kind: "return", name, version, source_hash, from_height, from_ms}.

    `version` is the one that comes back, at the time `from_ms`.
    """
    return read_value(state, MACHINE_TRIALS.flat) or []


def read_record(state: Reader, name: str, version: int) -> Row | None:
    """Return a version's entry as the contract `lifecycle` keeps it, or None if it names no source."""
    record = read_value(state, VERSION.key(name, version))
    return record if isinstance(record, dict) and _is_hash(record.get("source_hash")) else None


def is_full_record(record: object) -> bool:
    """Whether a version's entry has every field, and the interface, in the form that `lifecycle` gives them."""
    if not isinstance(record, dict) or not _is_hash(record.get("source_hash")):
        return False
    if not all(type(record.get(field)) is kind for field, kind in _RECORD_FIELDS.items()):
        return False
    entries = record.get("entries")
    return isinstance(entries, list) and all(_is_entry(entry) for entry in entries)


def _is_entry(entry: object) -> bool:
    """Whether a value is [name, kind, parameters, how many of them are required, type of the result]."""
    if not isinstance(entry, list) or len(entry) != 5:
        return False
    name, kind, params, required, returns = entry
    known = all(isinstance(text, str) for text in (name, kind, returns)) and is_count(required)
    return known and isinstance(params, list) and all(_is_parameter(param) for param in params)


def _is_parameter(param: object) -> bool:
    return isinstance(param, list) and len(param) == 2 and all(isinstance(text, str) for text in param)
