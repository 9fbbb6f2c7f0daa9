"""Makes one genesis file of many parties' entries, the same for whoever has them, and compares it with one's own."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from clients.sdk.new_files import read_given_text, replace_file, require_seen
from clients.sdk.node_places import check_place, place_of
from clients.sdk.trust_pin import PIN_FILE
from consensus.bounded_text import JSON_MAX_BYTES, read_json_text
from consensus.chain.genesis import (
    GENESIS_VERSION,
    ChainSettings,
    Genesis,
    NodeEntry,
    Organisation,
    genesis_from_json,
    genesis_to_json,
    require_possession,
)
from consensus.errors import BlockRobotError
from consensus.limits import PRODUCERS_MAX_COUNT
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.rights.purposes import PURPOSES
from contracts.execution.genesis import complete_genesis
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from contracts.lifecycle.registry import contract_entries, load_contracts
from contracts.state.view import MemoryState
from contracts.vm import LANGUAGE_VERSION
from network.provisioning.authority_check import check_authority
from network.provisioning.exchange_files import ORGANISATION_ENTRY_FILE, read_node_entry
from network.provisioning.founding_entries import NodeOffer, OrganisationOffer, refuse
from network.provisioning.new_node import (
    DRAFT_FILE,
    NODE_ENTRY_FILE,
    require_certified,
)
from node.config import CONFIG_FILE, load_config
from node.storage.directory_lock import DirectoryLock
from node.storage.lmdb_store import DATA_FILE_NAME

NETWORK_NAME = "blockrobot"
AHEAD_MAX_MS = 600_000
"""By how much a founder's clock may be ahead of that of who looks."""
_DIGITS = re.compile(r"\d+")


def make_genesis(
    organisations: Sequence[OrganisationOffer],
    nodes: Sequence[NodeOffer],
    *,
    network: str = NETWORK_NAME,
    settings: ChainSettings | None = None,
) -> Genesis:
    """The same offers make the same file, in whatever order: it begins when the last node's entry was made.

    Raises FOUNDING_ENTRY_INVALID, naming the entry or the two that do not fit.
    """
    for node in nodes:
        _check_signer(node, organisations)
    _check_entries(
        [(offer.source, offer.organisation) for offer in organisations], [(node.source, node.entry) for node in nodes]
    )
    producers = [offer for offer in nodes if offer.entry.producer_key]
    if not 1 <= len(producers) <= PRODUCERS_MAX_COUNT:
        detail = f"The entries name {len(producers)} producers; a network is founded by 1 to {PRODUCERS_MAX_COUNT}."
        raise BlockRobotError("FOUNDING_ENTRY_INVALID", detail)
    genesis = Genesis(
        version=GENESIS_VERSION,
        network=network,
        created_at_ms=max(offer.made_at_ms for offer in nodes),
        settings=settings or ChainSettings(),
        organisations=tuple(sorted((offer.organisation for offer in organisations), key=_by_name)),
        nodes=tuple(sorted((offer.entry for offer in nodes), key=_by_name)),
        contracts=contract_entries(),
        purposes=tuple(PURPOSES),
        state_root=b"",
        contract_language=LANGUAGE_VERSION,
    )
    return complete_genesis(genesis)


def _by_name(entry: NodeEntry | Organisation) -> tuple[str, str]:
    """So that node-2 comes before node-10, and node-01 before node-1 wherever it stood."""
    return _DIGITS.sub(lambda digits: digits[0].zfill(12), entry.name), entry.name


def require_begun(genesis: Genesis, now_ms: int) -> None:
    """No block is made before a network's beginning. Raises GENESIS_INVALID for one that lies ahead."""
    ahead_ms = genesis.created_at_ms - now_ms
    if ahead_ms > AHEAD_MAX_MS:
        detail = (
            f"The network would begin in {ahead_ms / 3_600_000:.0f} hours, and make no block until then: the clock of "
            "whoever made the last node's entry is wrong."
        )
        raise BlockRobotError("GENESIS_INVALID", detail)


def _check(source: str, check: Callable[[], None]) -> None:
    try:
        check()
    except BlockRobotError as error:
        raise refuse(source, f"cannot be used: {error.detail.rstrip('.')}") from None


def _check_signer(offer: NodeOffer, organisations: Sequence[OrganisationOffer]) -> None:
    owner = offer.entry.organisation
    found = [each.organisation for each in organisations if each.organisation.name == owner]
    if not found:
        raise refuse(offer.source, f"is of the organisation {owner!r}, whose entry is missing")
    if not any(offer.admin in each.admins for each in found):
        raise refuse(offer.source, f"is signed by nobody of {owner!r}")
    if offer.made_at_ms <= 0:
        raise refuse(offer.source, "has no time")


def _check_entries(organisations: Sequence[tuple[str, Organisation]], nodes: Sequence[tuple[str, NodeEntry]]) -> None:
    """Each by itself, and that no two have what only one may have; with the source of each, for its refusal."""
    all_owners = [owner for _, owner in organisations]
    names_alone = [msgspec.structs.replace(owner, ca_certificate="") for owner in all_owners]
    for source, owner in organisations:
        _check(source, partial(_check_form, "add_org", owner))
        # First by the names in it: of two that have one certificate, whose name it does not bear is told of.
        _check(source, partial(check_authority, owner.ca_certificate, owner.name, names_alone))
    for source, owner in organisations:
        _check(source, partial(check_authority, owner.ca_certificate, owner.name, all_owners))
    names = {owner.name for owner in all_owners}
    for source, entry in nodes:
        _check(source, partial(_check_form, "add_node", entry))
        if entry.organisation not in names:
            raise refuse(source, f"is of the organisation {entry.organisation!r}, whose entry is missing")
        _check(source, partial(check_place, entry.name, entry.host, entry.p2p_port, entry.api_url))
    _refuse_second(((source, owner.name) for source, owner in organisations), "the name")
    _refuse_second(((source, owner.ca_certificate) for source, owner in organisations), "a certificate")
    _refuse_second(((source, entry.name) for source, entry in nodes), "the name")
    places = ((source, ((entry.host, entry.p2p_port), place_of(entry.api_url))) for source, entry in nodes)
    _refuse_second(((source, f"{host} port {port}") for source, both in places for host, port in both), "the address")
    owned = ((source, (*owner.admins, *owner.registrars)) for source, owner in organisations)
    held = ((source, (entry.producer_key, entry.custodian_key)) for source, entry in nodes)
    _refuse_second(((source, key) for source, keys in (*owned, *held) for key in keys if key), "a key")


def _check_form(kind: str, entry: NodeEntry | Organisation) -> None:
    """As the chain looks at one that is to be let in later. Raises CALL_REFUSED."""
    fields = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in msgspec.structs.asdict(entry).items()
    }
    nowhere = BlockContext(chain_id=bytes(HASH_SIZE_BYTES), height=0, time_ms=0)
    run_view(MemoryState(), load_contracts(), nowhere, "forms", "check", [kind, fields])


def _refuse_second(values: Iterable[tuple[str, str | bytes]], what: str) -> None:
    first: dict[str | bytes, str] = {}
    for source, value in values:
        if value in first:
            shown = f" {value!r}" if isinstance(value, str) and len(value) <= 80 else ""
            raise refuse(source, f"has {what}{shown} that {first[value]} has too")
        first[value] = source


def check_genesis(genesis: Genesis) -> None:
    """Whether a file that somebody made is whole: its state follows from its entries, and these fit each other.

    Raises GENESIS_INVALID, FOUNDING_ENTRY_INVALID.
    """
    require_possession(genesis)
    _check_entries(
        [(f"organisation {owner.name}", owner) for owner in genesis.organisations],
        [(f"node {entry.name}", entry) for entry in genesis.nodes],
    )
    if complete_genesis(genesis).state_root != genesis.state_root:
        raise BlockRobotError("GENESIS_INVALID", "The state root does not follow from the entries.")


def find_own_differences(
    genesis: Genesis, organisations: Sequence[OrganisationOffer], nodes: Sequence[NodeOffer]
) -> Iterator[str]:
    """Yield what a genesis file says otherwise of one's own organisations and nodes than one's own entries."""
    named = {entry.name: entry for entry in genesis.organisations}
    for offer in organisations:
        own = offer.organisation
        yield from _differences(f"organisation {own.name}", own, named.get(own.name))
    entered = {entry.name: entry for entry in genesis.nodes}
    for node in nodes:
        yield from _differences(f"node {node.entry.name}", node.entry, entered.get(node.entry.name))
        owner = named.get(node.entry.organisation)
        if owner is not None and node.admin not in owner.admins:
            yield f"organisation {owner.name}: its admins are others than the one who signed the entry of {node.entry.name}"
    owners = {offer.organisation.name for offer in organisations}
    for name, entry in entered.items():
        if entry.organisation in owners and name not in {node.entry.name for node in nodes}:
            yield f"node {name}: it is entered as one of {entry.organisation}, and there is no entry of it here"


def _differences(what: str, own: NodeEntry | Organisation, found: NodeEntry | Organisation | None) -> Iterator[str]:
    if found is None:
        yield f"{what}: it is missing"
        return
    for field in own.__struct_fields__:
        if getattr(own, field) != getattr(found, field):
            yield f"{what}: {field} is another one"


def find_differences(one: Genesis, other: Genesis) -> list[str]:
    """Name the parts in which two genesis files differ, with their values where these are short."""
    first, second = (dict(_flat(read_json_text(genesis_to_json(genesis)))) for genesis in (one, other))
    names = sorted({*first, *second} - {name for name, value in first.items() if second.get(name) == value})
    return [f"{name}: {_shown(first.get(name))} here, {_shown(second.get(name))} there" for name in names]


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and all(isinstance(item, dict) and "name" in item for item in value):
        for item in value:
            yield from _flat({key: inner for key, inner in item.items() if key != "name"}, f"{name}.{item['name']}")
    else:
        yield name, value


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value)
    return text if len(text) <= 48 else f"{text[:22]}...{text[-22:]}"


def fingerprint(genesis: Genesis) -> str:
    """128 bits of the chain's id in groups of four digits, to be read out on the telephone."""
    digits = genesis.chain_id.hex()[:32]
    return " ".join(digits[place : place + 4] for place in range(0, 32, 4))


def find_own_entries(network: Path, data_dirs: Iterable[Path] = (), offered: Genesis | None = None) -> list[Path]:
    """Return the entry files of a network's folder, and of data directories elsewhere.

    Not of what came later to a network that was founded by now, by the genesis file `offered`. Raises NODE_NOT_CERTIFIED,
    GENESIS_INVALID, PermissionError.
    """
    require_seen(network / "organisations", ORGANISATION_ENTRY_FILE)
    require_seen(network / "nodes", NODE_ENTRY_FILE)
    for draft in [*network.glob(f"nodes/*/{DRAFT_FILE}"), *(place / DRAFT_FILE for place in data_dirs)]:
        require_certified(draft.parent)
    found = sorted(network.glob(f"organisations/*/{ORGANISATION_ENTRY_FILE}"))
    found += sorted(network.glob(f"nodes/*/{NODE_ENTRY_FILE}"))
    found += [place / NODE_ENTRY_FILE for place in data_dirs]
    return [path for path in found if not _came_later(path, network, offered)]


def _came_later(entry: Path, network: Path, offered: Genesis | None) -> bool:
    """Whether the genesis file here does not name the node or the organisation of an entry."""
    is_node = entry.name == NODE_ENTRY_FILE
    path = (entry.parent if is_node else network) / "genesis.json"
    if not path.is_file():
        return False
    begun = genesis_from_json(read_given_text(path, JSON_MAX_BYTES))
    if is_node:
        return read_node_entry(entry)["name"] not in {node.name for node in begun.nodes}
    return begun == offered and entry.parent.name not in {owner.name for owner in begun.organisations}


@contextmanager
def unstarted(network: Path, data_dirs: Iterable[Path]) -> Iterator[str]:
    """Hold nodes from starting; yield what was done by their genesis file already, or nothing.

    Raises DATA_DIRECTORY_IN_USE if one runs.
    """
    with ExitStack() as held:
        places = {path.parent.resolve() for path in network.glob(f"nodes/*/{CONFIG_FILE}")}
        for place in sorted({*places, *(place.resolve() for place in data_dirs)}):
            if (load_config(place).ledger_dir / DATA_FILE_NAME).is_file():
                yield f"the node in {place} has started by it"
                return
            held.callback(DirectoryLock(place).release)
        yield f"{network / PIN_FILE} shows that its network was spoken to" if (network / PIN_FILE).is_file() else ""


def adopt_genesis(genesis: Genesis, directory: Path, data_dirs: Iterable[Path]) -> None:
    """Write the file into a network's folder and its nodes' data directories."""
    text = genesis_to_json(genesis)
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    for place in (directory, *data_dirs):
        replace_file(place / "genesis.json", text.encode(), 0o644)
