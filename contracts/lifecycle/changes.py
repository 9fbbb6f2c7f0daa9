"""The rows that the machine accepts as contract changes.

Other forms are ignored; the machine's own tables are beyond every contract's reach.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple, TypeGuard

from consensus.primitives.encoding import EXACT_INTEGER_END, decode_value
from consensus.state.keys import HASH_BYTES, Reader, try_convert
from consensus.state.lifecycle import DUE, MACHINE, MACHINE_TRIALS, VERSION, ChangeRow, TrialRow, VersionRow

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
_VERSION_MAX = 0xFFFF_FFFF


class Due(NamedTuple):
    """A change, and its value in the state, which may have fields of later versions."""

    row: ChangeRow
    value: Any


def read_value(state: Reader, key: bytes) -> Any:
    data = state.get(key)
    return None if data is None else decode_value(data)


def is_count(value: object) -> TypeGuard[int]:
    """Whether it is an integer from 0 exact in JSON; booleans are not."""
    return type(value) is int and 0 <= value < EXACT_INTEGER_END


def _is_hash(value: object) -> bool:
    return isinstance(value, bytes) and len(value) == HASH_BYTES


def _is_change(row: ChangeRow) -> bool:
    known = row.kind in _KINDS and row.name != MACHINE and _NAME.fullmatch(row.name) is not None
    return known and 0 < row.version <= _VERSION_MAX and is_count(row.from_height) and is_count(row.from_ms)


def changes_in(value: object) -> list[Due]:
    """Return what the machine accepts as changes; whatever has another form is left out."""
    found = [(try_convert(each, ChangeRow), each) for each in value] if isinstance(value, list) else []
    return [Due(row, each) for row, each in found if row is not None and _is_change(row)]


def read_due(state: Reader) -> list[Due]:
    return changes_in(read_value(state, DUE.flat))


def read_trials(state: Reader) -> list[TrialRow]:
    return MACHINE_TRIALS.read(state) or []


def read_record(state: Reader, name: str, version: int) -> dict[str, Any] | None:
    """Return a version's `lifecycle` record, or None if it names no source; the machine needs no other field."""
    record = read_value(state, VERSION.key(name, version))
    return record if isinstance(record, dict) and _is_hash(record.get("source_hash")) else None


def to_version(record: object) -> VersionRow | None:
    """Return a version's record, or None if it has another form."""
    row = try_convert(record, VersionRow)
    fits = row is not None and _is_hash(row.source_hash) and all(is_count(entry.required) for entry in row.entries)
    return row if fits else None
