"""The chain's contracts as proved: versions, interfaces, sources, also proposed ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from clients.sdk.chain.governance import MembershipView, ProvedProposal, read_membership
from clients.sdk.network_client import NetworkClient
from consensus.api_documents import PROOF_KEYS_MAX_COUNT
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.lifecycle import (
    DUE,
    MACHINE_SOURCE,
    MACHINE_SOURCE_PART,
    MACHINE_TABLE,
    MACHINE_TRIALS,
    SOURCE,
    SOURCE_PART,
    UPLOAD_PART,
    UPLOADS,
    VERDICT,
    VERSION,
    VERSIONS,
    ChangeRow,
    ContractEntryRow,
)
from consensus.visible_text import split_lines
from contracts.kit.arguments import signature_of
from contracts.lifecycle.changes import to_version
from contracts.lifecycle.describing import (
    NamedContract,
    NamedVersion,
    contract_rows,
    due_rows,
    name_version,
    read_newest,
)
from contracts.lifecycle.registry import compute_source_hash, find_shipped_source
from contracts.vm import compile_contract
from contracts.vm.compiler.compile_cache import describe_source


@dataclass(frozen=True, slots=True)
class ContractsView:
    """All contracts at a height, with due changes, open proposals and `failed` newest versions."""

    height: int
    contracts: tuple[NamedContract, ...]
    due: tuple[ChangeRow, ...]
    membership: MembershipView
    failed: tuple[NamedVersion, ...] = ()

    @property
    def proposals(self) -> list[ProvedProposal]:
        return [row for row in self.membership.proposals if row.contract == "lifecycle"]

    def find(self, name: str) -> NamedContract | None:
        return next((row for row in self.contracts if row.name == name), None)


@dataclass(frozen=True, slots=True)
class Edition:
    """A source with its metadata: a chain version, or a proposal or file (no row)."""

    title: str
    source: str
    abi: Sequence[ContractEntryRow]
    row: NamedVersion | None = None
    proposal: ProvedProposal | None = None

    def line(self, number: int | None) -> str:
        """Stripped; empty if out of range."""
        lines = split_lines(self.source)
        return lines[number - 1].strip() if number is not None and 0 < number <= len(lines) else ""


async def _values(client: NetworkClient, keys: Iterable[bytes], key: PrivateKey) -> tuple[dict[bytes, Any], int]:
    wanted, found, height = list(dict.fromkeys(keys)), {}, 0
    for first in range(0, len(wanted), PROOF_KEYS_MAX_COUNT):
        part = await client.state_values(wanted[first : first + PROOF_KEYS_MAX_COUNT], key)
        found.update(part.values)
        height = part.height
    return found, height


async def read_contracts(client: NetworkClient, key: PrivateKey) -> ContractsView:
    """With due and proposed changes. Raises NOT_FOUND without a lifecycle."""
    membership = await read_membership(client, key)
    found, _ = await _values(client, [MACHINE_TABLE.flat, DUE.flat, MACHINE_TRIALS.flat], key)
    table = MACHINE_TABLE.among(found)
    if table is None:
        raise BlockRobotError("NOT_FOUND", "This chain has no contract for its contracts; it is older than that.")
    numbers = {name: VERSIONS.key(name) for name in table}
    versions, height = await _values(client, numbers.values(), key)
    rows = contract_rows(table, {name: read_newest(versions[place]) for name, place in numbers.items()})
    return ContractsView(
        height=height,
        contracts=tuple(rows),
        due=tuple(due_rows(found[DUE.flat], MACHINE_TRIALS.among(found) or [])),
        membership=membership,
        failed=await _read_failed(client, key, rows),
    )


async def _read_failed(
    client: NetworkClient, key: PrivateKey, rows: Iterable[NamedContract]
) -> tuple[NamedVersion, ...]:
    newest = {VERSION.key(row.name, row.versions): row for row in rows if row.versions > row.version}
    records, _ = await _values(client, newest, key)
    known = {place: record for place, record in records.items() if to_version(record) is not None}
    found = [name_version(newest[place].name, newest[place].versions, record) for place, record in known.items()]
    return tuple(row for row in found if row.status == "failed")


async def read_edition(client: NetworkClient, key: PrivateKey, name: str, version: int) -> Edition:
    """0: the active version. Raises CONTRACT_NOT_FOUND."""
    count_key = VERSIONS.key(name)
    found, _ = await _values(client, [MACHINE_TABLE.flat, count_key], key)
    newest = read_newest(found[count_key])
    active = (MACHINE_TABLE.among(found) or {}).get(name)
    number = version or (newest if active is None else active.version)
    place = VERSION.key(name, number) if 0 < number <= newest else b""
    record = (await _values(client, [place], key))[0][place] if place else None
    if record is None:
        what = f"contract {name!r}" if newest == 0 else f"version {version} of {name!r}, only 1 to {newest}"
        raise BlockRobotError("CONTRACT_NOT_FOUND", f"The chain has no {what}.")
    row = name_version(name, number, record)
    source = find_shipped_source(row.source_hash)
    if source is None:
        kept, approved = MACHINE_SOURCE.key(row.source_hash), SOURCE.key(row.source_hash)
        entries = (await _values(client, [kept, approved], key))[0]
        # A version that was never in force stands only where it was approved.
        place, part = (kept, MACHINE_SOURCE_PART) if entries[kept] is not None else (approved, SOURCE_PART)
        count = 0 if entries[place] is None else entries[place]["parts"]
        keys = [part.key(row.source_hash, number) for number in range(count)]
        source = await _join(client, key, keys, row.source_hash)
    return Edition(f"{name} version {number}", source, row.entries, row)


async def read_proposed(client: NetworkClient, key: PrivateKey, proposal: ProvedProposal) -> Edition:
    """What a proposal concerns. Raises CONTRACT_NOT_FOUND."""
    if proposal.kind != "deploy":
        name, version = str(proposal.arguments["name"]), int(proposal.arguments.get("version", 0))
        return replace(await read_edition(client, key, name, version), proposal=proposal)
    source_hash, name = proposal.arguments["source_hash"], str(proposal.arguments["name"])
    place, judged = UPLOADS.key(proposal.organisation), VERDICT.key(proposal.organisation, source_hash)
    found, _ = await _values(client, [place, judged], key)
    parts = next((entry["parts"] for entry in found[place] or [] if entry["source_hash"] == source_hash), 0)
    keys = [UPLOAD_PART.key(proposal.organisation, source_hash, number) for number in range(parts)]
    source = await _join(client, key, keys, source_hash)
    try:
        abi = msgspec.convert(found[judged][1]["entries"], list[ContractEntryRow])
    except (msgspec.ValidationError, TypeError, LookupError):
        raise BlockRobotError("CONTRACT_NOT_FOUND", "What the chain says of this source cannot be read.") from None
    return Edition(f"{name} as proposed in {proposal.id.hex()[:12]}", source, abi, proposal=proposal)


async def _join(client: NetworkClient, key: PrivateKey, keys: list[bytes], source_hash: bytes) -> str:
    found = (await _values(client, keys, key))[0] if keys else {}
    try:
        source = b"".join(found[place] or b"" for place in keys).decode()
    except UnicodeDecodeError:
        source = ""
    if not keys or compute_source_hash(source) != source_hash:
        raise BlockRobotError("CONTRACT_NOT_FOUND", "The source is not (or no longer) on the chain.")
    return source


def edition_of_source(source: str, name: str, title: str) -> Edition:
    """Raises CONTRACT_SOURCE_INVALID."""
    facts = describe_source(source.encode(), compile_contract(source, name))
    return Edition(title, source, msgspec.convert(facts["entries"], list[ContractEntryRow]))


def compare_interfaces(old: Edition, new: Edition) -> list[tuple[str, str]]:
    """(added | removed | changed | compatible, sentence) per name, in order. `compatible`: every call accepted before still
    is.
    """
    before, after = ({entry.name: entry for entry in edition.abi} for edition in (old, new))
    changes: list[tuple[str, str]] = []
    for name in sorted(before.keys() | after.keys()):
        one, other = before.get(name), after.get(name)
        if one is None and other is not None:
            changes.append(("added", f"{other.kind} {signature_of(other)}"))
        elif other is None and one is not None:
            changes.append(("removed", f"{one.kind} {signature_of(one)}"))
        elif one is not None and other is not None and one != other:
            kind = "compatible" if _takes_all(one, other) else "changed"
            changes.append((kind, f"{one.kind} {signature_of(one)}  ->  {other.kind} {signature_of(other)}"))
    return changes


def _takes_all(old: ContractEntryRow, new: ContractEntryRow) -> bool:
    types = [kind for _, kind in old.params]
    same = [kind for _, kind in new.params][: len(types)] == types
    return old.kind == new.kind and old.returns == new.returns and same and new.required <= old.required
