"""Query rows of contracts and their versions, read from the state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from consensus.errors import BlockRobotError
from consensus.limits import CONTRACT_NAME_MAX_CHARS
from consensus.primitives.encoding import decode_value
from consensus.state.keys import Reader
from consensus.state.lifecycle import DUE, MACHINE_TABLE, MACHINE_TRIALS, VERSION, VERSIONS
from contracts.lifecycle.catalogue import read_source_of
from contracts.lifecycle.changes import (
    changes_in,
    is_count,
    is_full_record,
    read_value,
)

ROWS_KEPT_COUNT = 256


@dataclass(frozen=True, slots=True)
class ContractRow:
    """A contract: active version, source hash, whether it answers, since which height, version count."""

    name: str
    version: int
    source_hash: bytes
    enabled: bool
    since_height: int
    versions: int


@dataclass(frozen=True, slots=True)
class ChangeDue:
    """A pending change, due by height or time in ms; `kind` is activate, disable, keep or return."""

    kind: str
    name: str
    version: int
    from_height: int
    from_ms: int


@dataclass(frozen=True, slots=True)
class EntryRow:
    """A version's entry: typed parameters, required count, result type."""

    name: str
    kind: str
    params: tuple[tuple[str, str], ...]
    required: int
    returns: str


@dataclass(frozen=True, slots=True)
class VersionRow:
    """A contract version as kept by `lifecycle`; `status` is approved, active, superseded, ..."""

    name: str
    version: int
    source_hash: bytes
    size_bytes: int
    migrates: bool
    note: str
    organisation: str
    proposal_id: bytes
    approved_height: int
    status: str
    since_height: int
    failure: str
    abi: tuple[EntryRow, ...]


def entry_rows(entries: Any) -> tuple[EntryRow, ...]:
    return tuple(
        EntryRow(name, kind, tuple((param, of) for param, of in params), required, returns)
        for name, kind, params, required, returns in entries
    )


def version_row(name: str, version: int, record: Any) -> VersionRow:
    """Raises CONTRACT_NOT_FOUND if a `lifecycle` version stored another form."""
    if not is_full_record(record):
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The entry of version {version} of {name!r} cannot be read.")
    fields = {field: record[field] for field in VersionRow.__dataclass_fields__ if field in record}
    return VersionRow(name=name, version=version, abi=entry_rows(record["entries"]), **fields)


@lru_cache(maxsize=ROWS_KEPT_COUNT)
def _decode_row(name: str, version: int, data: bytes) -> VersionRow:
    return version_row(name, version, decode_value(data))


def contract_rows(table: dict[str, Any], versions: dict[str, int]) -> list[ContractRow]:
    return [
        ContractRow(name, version, source_hash, enabled, since_height, versions.get(name, 0))
        for name, (version, source_hash, enabled, since_height) in sorted(table.items())
    ]


def due_rows(due: object, trials: object) -> list[ChangeDue]:
    names = ChangeDue.__dataclass_fields__
    rows = [*changes_in(due), *(trials if isinstance(trials, list) else [])]
    return [ChangeDue(**{field: row[field] for field in names}) for row in rows]


def read_newest(value: object) -> int:
    """Return the newest version number from the `VERSIONS` value, or 0."""
    return value if is_count(value) else 0


def list_contracts(state: Reader) -> list[ContractRow]:
    table = read_value(state, MACHINE_TABLE.flat) or {}
    return contract_rows(table, {name: _newest(state, name) for name in table})


def _newest(state: Reader, name: str) -> int:
    return read_newest(read_value(state, VERSIONS.key(name)))


def list_due(state: Reader) -> list[ChangeDue]:
    return due_rows(read_value(state, DUE.flat), read_value(state, MACHINE_TRIALS.flat))


def read_version(state: Reader, name: str, version: int) -> VersionRow:
    """Return a version; 0 means active or else newest. Raises CONTRACT_NOT_FOUND."""
    if not 0 < len(name) <= CONTRACT_NAME_MAX_CHARS:
        raise BlockRobotError("CONTRACT_NOT_FOUND")
    newest = _newest(state, name)
    number = version or (read_value(state, MACHINE_TABLE.flat) or {}).get(name, [newest])[0]
    data = state.get(VERSION.key(name, number)) if 0 < number <= newest else None
    if data is None:
        what = f"contract {name!r}" if newest == 0 else f"version {version} of {name!r}, only 1 to {newest}"
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The chain has no {what}.")
    return _decode_row(name, number, data)


def active_contract(state: Reader, name: str) -> tuple[int, bool, int] | None:
    """Return (active version, whether it answers, since height), or None."""
    row = (read_value(state, MACHINE_TABLE.flat) or {}).get(name)
    return None if row is None else (row[0], row[2], row[3])


def read_version_source(state: Reader, row: VersionRow) -> str:
    """Return a version's source. Raises STORAGE_DAMAGED."""
    return read_source_of(state, row.source_hash)
