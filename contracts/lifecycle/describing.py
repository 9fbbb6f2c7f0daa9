"""Query rows of contracts and their versions, read from the state."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from msgspec.structs import asdict

from consensus.errors import BlockRobotError
from consensus.limits import CONTRACT_NAME_MAX_CHARS
from consensus.primitives.encoding import decode_value
from consensus.state.keys import Reader
from consensus.state.lifecycle import (
    DUE,
    MACHINE_TABLE,
    VERSION,
    VERSIONS,
    ChangeRow,
    ContractRow,
    TableRow,
    TrialRow,
    VersionRow,
)
from contracts.lifecycle.catalogue import read_source_of
from contracts.lifecycle.changes import (
    changes_in,
    is_count,
    read_trials,
    read_value,
    to_version,
)

ROWS_KEPT_COUNT = 256


class NamedContract(ContractRow, frozen=True):
    """A contract in force, with its name and the number of its versions."""

    name: str
    versions: int


class NamedVersion(VersionRow, frozen=True):
    """A version with its contract's name and its number."""

    name: str
    version: int


def name_version(name: str, version: int, record: object) -> NamedVersion:
    """Raises CONTRACT_NOT_FOUND if a `lifecycle` version stored another form."""
    row = to_version(record)
    if row is None:
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The entry of version {version} of {name!r} cannot be read.")
    return NamedVersion(**asdict(row), name=name, version=version)


@lru_cache(maxsize=ROWS_KEPT_COUNT)
def _decode_row(name: str, version: int, data: bytes) -> NamedVersion:
    return name_version(name, version, decode_value(data))


def contract_rows(table: TableRow, versions: dict[str, int]) -> list[NamedContract]:
    return [
        NamedContract(**asdict(row), name=name, versions=versions.get(name, 0)) for name, row in sorted(table.items())
    ]


def due_rows(due: object, trials: Iterable[TrialRow]) -> list[ChangeRow]:
    return [*(each.row for each in changes_in(due)), *trials]


def read_newest(value: object) -> int:
    """Return the newest version number from the `VERSIONS` value, or 0."""
    return value if is_count(value) else 0


def list_contracts(state: Reader) -> list[NamedContract]:
    table = MACHINE_TABLE.read(state) or {}
    return contract_rows(table, {name: _newest(state, name) for name in table})


def _newest(state: Reader, name: str) -> int:
    return read_newest(read_value(state, VERSIONS.key(name)))


def list_due(state: Reader) -> list[ChangeRow]:
    return due_rows(read_value(state, DUE.flat), read_trials(state))


def read_version(state: Reader, name: str, version: int) -> NamedVersion:
    """Return a version; 0 means active or else newest. Raises CONTRACT_NOT_FOUND."""
    if not 0 < len(name) <= CONTRACT_NAME_MAX_CHARS:
        raise BlockRobotError("CONTRACT_NOT_FOUND")
    newest = _newest(state, name)
    active = active_contract(state, name)
    number = version or (newest if active is None else active.version)
    data = state.get(VERSION.key(name, number)) if 0 < number <= newest else None
    if data is None:
        what = f"contract {name!r}" if newest == 0 else f"version {version} of {name!r}, only 1 to {newest}"
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The chain has no {what}.")
    return _decode_row(name, number, data)


def active_contract(state: Reader, name: str) -> ContractRow | None:
    return (MACHINE_TABLE.read(state) or {}).get(name)


def read_version_source(state: Reader, row: NamedVersion) -> str:
    """Raises STORAGE_DAMAGED."""
    return read_source_of(state, row.source_hash)
