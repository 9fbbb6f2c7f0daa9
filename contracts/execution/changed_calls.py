"""Says of a call that the active version of a contract does not take what is wrong, and what changed. Must never guess.

The sentence is part of the receipt, so it follows from the state alone.
"""

from __future__ import annotations

from typing import Any

from consensus.primitives.encoding import decode_value, u32
from contracts.execution.catalogue import ActiveContracts, Reader
from contracts.vm import CompiledContract

CONTRACT_DISABLED = "CONTRACT_DISABLED"
CONTRACT_UNKNOWN = "CONTRACT_UNKNOWN"
ENTRY_UNKNOWN = "ENTRY_UNKNOWN"
ARGUMENTS_INVALID = "ARGUMENTS_INVALID"
VERSION_PREFIX = b"lifecycle\x00version/"
VERSIONS_LOOKED_AT_COUNT = 4
_HAS_ANSWERED = ("superseded", "disabled")


def explain_absence(contracts: object, name: str) -> tuple[str, str]:
    """Return the code and sentence for a contract that does not answer."""
    if isinstance(contracts, ActiveContracts) and name in contracts.disabled:
        since = contracts.since[name]
        return CONTRACT_DISABLED, f"The organisations have disabled {name} at height {since}."
    return CONTRACT_UNKNOWN, "There is no contract of this name."


def find_misfit(compiled: CompiledContract, entry: str, arguments: list[Any]) -> str:
    """Return ENTRY_UNKNOWN or ARGUMENTS_INVALID if a transaction cannot call this entry so, or an empty text."""
    found = compiled.entries.get(entry)
    if found is None or found.entry.kind != "export":
        return ENTRY_UNKNOWN
    if not found.entry.required <= len(arguments) <= len(found.accepts):
        return ARGUMENTS_INVALID
    fits = all(accepts(value) for accepts, value in zip(found.accepts, arguments, strict=False))
    return "" if fits else ARGUMENTS_INVALID


def explain_misfit(
    state: Reader, contracts: ActiveContracts, name: str, entry: str, arguments: list[Any]
) -> tuple[str, str] | None:
    """Return the code and sentence for a call that the active version does not take, or None if it takes it.

    The contract must be one that answers.
    """
    compiled = contracts[name]
    code = find_misfit(compiled, entry, arguments)
    if not code:
        return None
    version = contracts.versions.get(name, 1)
    active = f"Version {version} of {name} is active since height {contracts.since.get(name, 0)}"
    now = compiled.abi.entry(entry)
    former = _find_former(state, name, version, entry, len(arguments))
    if code == ENTRY_UNKNOWN:
        what = (
            f"has no entry {entry[:64]}" if now is None else f"has {entry} as a {now.kind}, which no transaction calls"
        )
        sentence = f"{active}: it {what}."
        return code, sentence if former is None else f"{sentence} Version {former[0]} had one."
    assert now is not None
    sentence = f"{active}: {entry} takes ({', '.join(kind for _, kind in now.params)})."
    return code, sentence if former is None else f"{sentence} Version {former[0]} took ({', '.join(former[1])})."


def _find_former(state: Reader, name: str, version: int, entry: str, count: int) -> tuple[int, list[str]] | None:
    """Return the nearest version that once answered and took such a call, with its parameters' types."""
    near = range(1, VERSIONS_LOOKED_AT_COUNT + 1)
    for number in [*(version - step for step in near), *(version + step for step in near)]:
        data = state.get(VERSION_PREFIX + name.encode() + b"/" + u32(number)) if number > 0 else None
        record = None if data is None else decode_value(data)
        if record is None or record["status"] not in _HAS_ANSWERED:
            continue
        for former, kind, params, required, _ in record["entries"]:
            if former == entry and kind == "export" and required <= count <= len(params):
                return number, [kind for _, kind in params]
    return None
