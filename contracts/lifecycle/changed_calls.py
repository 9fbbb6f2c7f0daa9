"""Explains calls that the active version of a contract does not accept.

The sentence is part of the receipt, so it depends on the state alone.
"""

from __future__ import annotations

import ast
from functools import lru_cache
from typing import Any

from consensus.errors import BlockRobotError
from consensus.state.keys import Reader
from consensus.state.lifecycle import ContractEntryRow, VersionRow
from contracts.lifecycle.catalogue import ActiveContracts
from contracts.lifecycle.describing import NamedVersion, read_version
from contracts.vm.frontend.abi import Accepts, parse_type
from contracts.vm.frontend.parser import parse_alone

CONTRACT_DISABLED = "CONTRACT_DISABLED"
CONTRACT_UNKNOWN = "CONTRACT_UNKNOWN"
ENTRY_UNKNOWN = "ENTRY_UNKNOWN"
ARGUMENTS_INVALID = "ARGUMENTS_INVALID"
VERSIONS_LOOKED_AT_COUNT = 4
_TYPES_KEPT_COUNT = 512
TYPE_MAX_CHARS = 1_000
_HAS_ANSWERED = ("superseded", "disabled")


def explain_absence(contracts: object, name: str) -> tuple[str, str]:
    if isinstance(contracts, ActiveContracts) and name in contracts.disabled:
        return CONTRACT_DISABLED, f"The organisations have disabled {name} at height {contracts.since[name]}."
    return CONTRACT_UNKNOWN, "There is no contract of this name."


@lru_cache(maxsize=_TYPES_KEPT_COUNT)
def _accepts(kind: str) -> Accepts:
    try:
        tree = parse_alone(kind, "eval") if len(kind) <= TYPE_MAX_CHARS else None
        accepts = parse_type(tree.body) if isinstance(tree, ast.Expression) else None
    except (SyntaxError, ValueError):
        accepts = None
    if accepts is None:
        raise BlockRobotError("STORAGE_DAMAGED", f"An interface in the state names {kind!r}, which is no type.")
    return accepts


def find_entry(row: VersionRow, name: str) -> ContractEntryRow | None:
    return next((entry for entry in row.entries if entry.name == name), None)


def find_misfit(found: ContractEntryRow | None, arguments: list[Any]) -> str:
    """Return ENTRY_UNKNOWN, ARGUMENTS_INVALID or an empty text if it fits."""
    if found is None or found.kind != "export":
        return ENTRY_UNKNOWN
    if not found.required <= len(arguments) <= len(found.params):
        return ARGUMENTS_INVALID
    fits = all(_accepts(kind)(value) for (_, kind), value in zip(found.params, arguments, strict=False))
    return "" if fits else ARGUMENTS_INVALID


def explain_misfit(
    state: Reader, row: NamedVersion, since_height: int, entry: str, arguments: list[Any]
) -> tuple[str, str] | None:
    now = find_entry(row, entry)
    try:
        code = find_misfit(now, arguments)
    except BlockRobotError:
        return None
    if not code:
        return None
    active = f"Version {row.version} of {row.name} is active since height {since_height}"
    former = _find_former(state, row, entry, len(arguments))
    if code == ENTRY_UNKNOWN or now is None:
        what = (
            f"has no entry {entry[:64]}" if now is None else f"has {entry} as a {now.kind}, which no transaction calls"
        )
        return code, f"{active}: it {what}." + ("" if former is None else f" Version {former[0]} had one.")
    sentence = f"{active}: {entry} takes {_signature(now)}."
    return code, sentence if former is None else f"{sentence} Version {former[0]} took {_signature(former[1])}."


def _signature(entry: ContractEntryRow) -> str:
    return f"({', '.join(kind for _, kind in entry.params)})"


def _find_former(state: Reader, row: NamedVersion, entry: str, count: int) -> tuple[int, ContractEntryRow] | None:
    near = range(1, VERSIONS_LOOKED_AT_COUNT + 1)
    for number in [*(row.version - step for step in near), *(row.version + step for step in near)]:
        try:
            other = read_version(state, row.name, number) if number > 0 else None
        except BlockRobotError:
            continue
        found = None if other is None or other.status not in _HAS_ANSWERED else find_entry(other, entry)
        if found is not None and found.kind == "export" and found.required <= count <= len(found.params):
            return number, found
    return None


def explain_call(
    state: Reader, contracts: ActiveContracts, name: str, entry: str, arguments: list[Any]
) -> tuple[str, str] | None:
    if name not in contracts.versions:
        return None
    try:
        row = read_version(state, name, contracts.versions[name])
    except BlockRobotError:
        return None
    return explain_misfit(state, row, contracts.since[name], entry, arguments)
