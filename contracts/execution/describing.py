"""What the state says of contracts and their versions, for those who ask. Must never run or compile one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from consensus.errors import BlockRobotError
from consensus.limits import CONTRACT_NAME_MAX_CHARS
from consensus.primitives.encoding import decode_value, u32
from contracts.execution.catalogue import TABLE_KEY, Reader, read_source_of

DUE_KEY = b"lifecycle\x00due"
VERSION_PREFIX = b"lifecycle\x00version/"
VERSIONS_PREFIX = b"lifecycle\x00versions/"
ROWS_KEPT_COUNT = 256


@dataclass(frozen=True, slots=True)
class ContractRow:
    """A contract: the version in force, the hash of its source, whether it answers, since when, how many versions."""

    name: str
    version: int
    source_hash: bytes
    enabled: bool
    since_height: int
    versions: int


@dataclass(frozen=True, slots=True)
class ChangeDue:
    """A change that waits for its height, or for a time in ms: `kind` is activate, disable or return."""

    kind: str
    name: str
    version: int
    from_height: int
    from_ms: int


@dataclass(frozen=True, slots=True)
class EntryRow:
    """An entry of a version: its parameters with their types, how many are required, what it returns."""

    name: str
    kind: str
    params: tuple[tuple[str, str], ...]
    required: int
    returns: str


@dataclass(frozen=True, slots=True)
class VersionRow:
    """A version of a contract, as the contract `lifecycle` keeps it. `status` is approved, active, superseded, ..."""

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


def version_key(name: str, version: int) -> bytes:
    """Return the flat key of a version's entry."""
    return VERSION_PREFIX + name.encode() + b"/" + u32(version)


def version_row(name: str, version: int, record: dict[str, Any]) -> VersionRow:
    """Make a row of a version's entry."""
    abi = tuple(
        EntryRow(entry, kind, tuple((param, of) for param, of in params), required, returns)
        for entry, kind, params, required, returns in record["entries"]
    )
    fields = {field: record[field] for field in VersionRow.__dataclass_fields__ if field in record}
    return VersionRow(name=name, version=version, abi=abi, **fields)


@lru_cache(maxsize=ROWS_KEPT_COUNT)
def _decode_row(name: str, version: int, data: bytes) -> VersionRow:
    return version_row(name, version, decode_value(data))


def contract_rows(table: dict[str, Any], versions: dict[str, int]) -> list[ContractRow]:
    """Make the rows of the lifecycle's table, by name."""
    return [
        ContractRow(name, version, source_hash, enabled, since_height, versions.get(name, 0))
        for name, (version, source_hash, enabled, since_height) in sorted(table.items())
    ]


def due_rows(due: list[dict[str, Any]]) -> list[ChangeDue]:
    """Make the rows of what is due."""
    names = ChangeDue.__dataclass_fields__
    return [ChangeDue(**{field: entry[field] for field in names}) for entry in due]


def _value(state: Reader, key: bytes, default: Any) -> Any:
    data = state.get(key)
    return default if data is None else decode_value(data)


def list_contracts(state: Reader) -> list[ContractRow]:
    """Return all contracts that ever were in force, by name."""
    table = _value(state, TABLE_KEY, {})
    return contract_rows(table, {name: _value(state, VERSIONS_PREFIX + name.encode(), 0) for name in table})


def list_due(state: Reader) -> list[ChangeDue]:
    """Return what waits for its height or time."""
    return due_rows(_value(state, DUE_KEY, []))


def read_version(state: Reader, name: str, version: int) -> VersionRow:
    """Return a version of a contract; 0 stands for the one in force, or the newest if none ever was.

    Raises CONTRACT_NOT_FOUND.
    """
    if not 0 < len(name) <= CONTRACT_NAME_MAX_CHARS:
        raise BlockRobotError("CONTRACT_NOT_FOUND")
    newest = _value(state, VERSIONS_PREFIX + name.encode(), 0)
    number = version or _value(state, TABLE_KEY, {}).get(name, [newest])[0]
    data = state.get(version_key(name, number)) if 0 < number <= newest else None
    if data is None:
        what = f"contract {name!r}" if newest == 0 else f"version {version} of {name!r}, only 1 to {newest}"
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The chain has no {what}.")
    return _decode_row(name, number, data)


def active_contract(state: Reader, name: str) -> tuple[int, bool, int] | None:
    """Return [the version in force, whether it answers, since which height] of a contract, or None."""
    row = _value(state, TABLE_KEY, {}).get(name)
    return None if row is None else (row[0], row[2], row[3])


def read_version_source(state: Reader, row: VersionRow) -> str:
    """Return a version's source. Raises STORAGE_DAMAGED if the state lacks it."""
    return read_source_of(state, row.source_hash)
