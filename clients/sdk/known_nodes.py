"""Known nodes and who keeps which clip: by the genesis file, then by proved state, kept with the pin."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from msgspec import structs

from clients.sdk.connections import NodeAddress, check_address
from clients.sdk.proof_checks import ProvedState
from consensus.chain.genesis import Genesis, NodeEntry
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire
from consensus.records.placement import Placement
from consensus.state.identity import ROOM
from consensus.state.membership import NODE, NODES, ORGANISATION, NodeRow
from consensus.state.settings import CUSTODY_COPIES, QUOTA

REFRESH_MS = 60_000
RETRY_MS = 5_000
NODES_MAX_COUNT = 64
ORGANISATIONS_MAX_COUNT = 32
STEPS_MAX_COUNT = 4


class KnownNode(Wire, frozen=True):
    """A known node, with its organisation's CA."""

    name: str
    api_url: str
    ca_certificate: str


class KnownCustodian(Wire, frozen=True):
    """A custodian: its node, organisation, key and declared room (GiB, 0: none)."""

    name: str
    organisation: str
    key: bytes
    room_gib: int = 0


class KnownNodes(Wire, frozen=True):
    """Active nodes as of a height; 0 is the genesis file's. `custodians`: even without a usable address."""

    height: int
    nodes: tuple[KnownNode, ...]
    custodians: tuple[KnownCustodian, ...]
    custody_copies: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(node.name for node in self.nodes)


class StateReading(Protocol):
    """Reads proved values (`NetworkClient.state_values`)."""

    async def __call__(self, keys: Sequence[bytes]) -> ProvedState: ...


def nodes_of_genesis(genesis: Genesis) -> KnownNodes:
    authorities = {organisation.name: organisation.ca_certificate for organisation in genesis.organisations}
    found = [KnownNode(node.name, node.api_url, authorities[node.organisation]) for node in genesis.nodes]
    return KnownNodes(0, tuple(found), _custodians_of(genesis.nodes), 0)


def _custodians_of(nodes: Collection[NodeEntry | NodeRow]) -> tuple[KnownCustodian, ...]:
    keeping = [node for node in nodes if node.custodian_key]
    return tuple(KnownCustodian(node.name, node.organisation, node.custodian_key) for node in keeping)


def address_of(node: KnownNode, url: str | None = None) -> NodeAddress:
    """Raises CONFIGURATION_INVALID."""
    return check_address(NodeAddress(node.name, (url or node.api_url).rstrip("/"), node.ca_certificate))


def _usable(node: KnownNode) -> bool:
    try:
        address_of(node)
    except BlockRobotError:
        return False
    return True


async def read_active_nodes(read: StateReading) -> tuple[int, list[NodeRow], int]:
    """Height, nodes and the setting `custody_copies`, proved; (0, none, 0) if unknown."""
    names = (NODES.among((await read([NODES.flat])).values) or [])[:NODES_MAX_COUNT]
    if not names:
        return 0, [], 0
    state = await read([QUOTA.key(CUSTODY_COPIES), *map(NODE.key, names)])
    rows = [NODE.among(state.values, name) for name in names]
    copies = QUOTA.among(state.values, CUSTODY_COPIES) or 0
    return state.height, [row for row in rows if row is not None and row.status == "active"], copies


async def read_known_nodes(read: StateReading, before: KnownNodes) -> KnownNodes:
    """Proved, known ones first; `before` if none is usable."""
    height, active, copies = await read_active_nodes(read)
    owners = sorted({row.organisation for row in active if row.api_url.startswith("https:")})[:ORGANISATIONS_MAX_COUNT]
    custodians = _custodians_of(active)
    keys = [*map(ORGANISATION.key, owners), *(ROOM.key(each.key) for each in custodians)]
    found = (await read(keys)).values if keys else {}
    rows = [ORGANISATION.among(found, name) for name in owners]
    certificates = {row.name: row.ca_certificate for row in rows if row is not None}
    rooms = {each.key: room.gib for each in custodians if (room := ROOM.among(found, each.key)) is not None}
    custodians = tuple(structs.replace(each, room_gib=rooms.get(each.key, 0)) for each in custodians)
    nodes = [KnownNode(row.name, row.api_url, certificates.get(row.organisation, "")) for row in active]
    places_before = {name: place for place, name in enumerate(before.names)}
    usable = [node for node in nodes if _usable(node)]
    usable.sort(key=lambda node: (places_before.get(node.name, len(places_before)), node.name))
    return KnownNodes(height, tuple(usable), custodians, copies) if usable else before


class NodeDirectory:
    """One client's nodes: a fixed list, or the network's, updated as learned."""

    def __init__(self, genesis: Genesis, urls: Mapping[str, str] | None, known: KnownNodes | None) -> None:
        """Raises CONFIGURATION_INVALID for invalid addresses, unknown names."""
        first = nodes_of_genesis(genesis)
        self.known = known if known is not None and known.nodes else first
        self.is_fixed = urls is not None
        self._learned_ms: int | None = None
        self._epoch = 0
        self._failed = False
        self.addresses = tuple(address_of(node) for node in self.known.nodes) if urls is None else ()
        if urls is not None:
            by_name = {node.name: node for node in [*first.nodes, *self.known.nodes]}
            unknown = [name for name in urls if name not in by_name]
            if unknown:
                raise BlockRobotError("CONFIGURATION_INVALID", f"Nobody knows a node {unknown[0]!r} in this network.")
            self.addresses = tuple(address_of(by_name[name], url) for name, url in urls.items())
        if not self.addresses:
            raise BlockRobotError("CONFIGURATION_INVALID", "There is no node to ask.")
        self._founding = first.custodians
        self._custodians = {each.name: each for each in self.known_custodians}
        self._given: dict[str, NodeAddress] = {}
        self.unlisted: tuple[NodeAddress, ...] = ()

    def give(self, node: NodeAddress) -> None:
        """Reach a node there, whatever the lists say. One on no list yet is asked before the others until one is read."""
        if node.name in self._given:
            return
        self._given[node.name] = node
        if all(node.name != other.name for other in self.addresses):
            self.unlisted += (node,)
        self.addresses = self._as_given(self.addresses)

    def _as_given(self, addresses: Sequence[NodeAddress]) -> tuple[NodeAddress, ...]:
        return tuple(
            replace(self._given[node.name], ca_certificate=node.ca_certificate) if node.name in self._given else node
            for node in addresses
        )

    def authority_of(self, name: str) -> str | None:
        """The CA certificate (PEM) of a known node's organisation."""
        known = [*self.addresses, *(address_of(node) for node in self.known.nodes)]
        return next((node.ca_certificate for node in known if node.name == name), None)

    @property
    def known_custodians(self) -> tuple[KnownCustodian, ...]:
        """The founding ones, who may have left, and the proved ones."""
        return tuple(dict.fromkeys((*self._founding, *self.known.custodians)))

    @property
    def custodians(self) -> tuple[NodeAddress, ...]:
        return tuple(node for node in self.addresses if node.name in self._custodians)

    def rank_custodians(self, record_id: bytes) -> tuple[tuple[NodeAddress, ...], tuple[NodeAddress, ...]]:
        """Those that keep a record's clip, of those with an address, and the others in the order in which they would."""
        proved = self.known.custodians
        rooms = {each.key: each.room_gib for each in proved}
        organisations = {each.key: each.organisation for each in proved}
        placement = Placement.of(rooms, self.known.custody_copies, organisations)
        places = {key: place for place, key in enumerate(placement.rank(record_id))}
        ranked = tuple(
            sorted(self.custodians, key=lambda node: places.get(self._custodians[node.name].key, len(places)))
        )
        return ranked[: placement.count], ranked[placement.count :]

    def note_failure(self) -> None:
        """A node that did not answer may have been removed."""
        self._failed = True

    def is_due(self, epoch: int, now_ms: int) -> bool:
        """New epoch, failed node, a minute passed."""
        if self.is_fixed:
            return False
        if self._learned_ms is None or epoch > self._epoch:
            return True
        return now_ms - self._learned_ms >= (RETRY_MS if self._failed else REFRESH_MS)

    def note_learned(self, epoch: int, now_ms: int) -> None:
        self._learned_ms, self._epoch, self._failed = now_ms, epoch, False

    def learn(self, found: KnownNodes) -> bool:
        """Return whether newer nodes changed anything."""
        if found.height > 0:
            self.unlisted = ()
        if found.height <= self.known.height:
            return False
        before, self.known = self.addresses, found
        self.addresses = self._as_given([address_of(node) for node in found.nodes])
        self._custodians = {each.name: each for each in found.custodians}
        return self.addresses != before
