"""Which nodes a client asks: first those of the genesis file, then those that the proved state names.

What was learned is
kept with the pin, so that a client finds the network even when none of the first nodes is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from clients.sdk.connections import NodeAddress, check_address
from clients.sdk.proof_checks import ProvedState
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire
from consensus.state.membership import NODE, NODES, ORGANISATION, NodeRow

REFRESH_MS = 60_000
RETRY_MS = 5_000
NODES_MAX_COUNT = 64
ORGANISATIONS_MAX_COUNT = 32
STEPS_MAX_COUNT = 4


class KnownNode(Wire, frozen=True):
    """A node as a client knows it. The CA certificate is that of its organisation, kept for addresses with HTTPS."""

    name: str
    api_url: str
    is_custodian: bool
    ca_certificate: str


class KnownNodes(Wire, frozen=True):
    """The active nodes, as the state of this height has them; height 0 is the genesis file's."""

    height: int
    nodes: tuple[KnownNode, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in the order in which they are asked."""
        return tuple(node.name for node in self.nodes)


class StateReading(Protocol):
    """How proved values are read: as `NetworkClient.state_values` does, in somebody's session."""

    async def __call__(self, keys: Sequence[bytes]) -> ProvedState:
        """Return proved values of up to 128 flat keys."""
        ...


def nodes_of_genesis(genesis: Genesis) -> KnownNodes:
    """Return the nodes that the genesis file names."""
    authorities = {organisation.name: organisation.ca_certificate for organisation in genesis.organisations}
    found = [
        KnownNode(node.name, node.api_url, bool(node.custodian_key), authorities[node.organisation])
        for node in genesis.nodes
    ]
    return KnownNodes(0, tuple(found))


def address_of(node: KnownNode, url: str | None = None) -> NodeAddress:
    """Return where to ask a node. Raises CONFIGURATION_INVALID for an address that a client may not use."""
    return check_address(NodeAddress(node.name, (url or node.api_url).rstrip("/"), node.ca_certificate))


def _usable(node: KnownNode) -> bool:
    """An address that no client may use is its organisation's mistake; the others are asked."""
    try:
        address_of(node)
    except BlockRobotError:
        return False
    return True


async def read_active_nodes(read: StateReading) -> tuple[int, list[NodeRow]]:
    """Return the active nodes, proved, and as of which height; height 0 and none if the chain says nothing of its nodes."""
    names = (NODES.among((await read([NODES.flat])).values) or [])[:NODES_MAX_COUNT]
    if not names:
        return 0, []
    state = await read([NODE.key(name) for name in names])
    rows = [NODE.among(state.values, name) for name in names]
    return state.height, [row for row in rows if row is not None and row.status == "active"]


async def read_known_nodes(read: StateReading, before: KnownNodes) -> KnownNodes:
    """Return the active nodes, proved; those that were known `before` keep their places, others follow by name.

    Returns `before` if the chain says nothing of its nodes or none of them could be asked. Raises what reading raises.
    """
    height, active = await read_active_nodes(read)
    owners = sorted({row.organisation for row in active if row.api_url.startswith("https:")})[:ORGANISATIONS_MAX_COUNT]
    certificates: dict[str, str] = {}
    if owners:
        found = (await read([ORGANISATION.key(name) for name in owners])).values
        rows = [ORGANISATION.among(found, name) for name in owners]
        certificates = {row.name: row.ca_certificate for row in rows if row is not None}
    nodes = [
        KnownNode(row.name, row.api_url, bool(row.custodian_key), certificates.get(row.organisation, ""))
        for row in active
    ]
    places_before = {name: place for place, name in enumerate(before.names)}
    usable = [node for node in nodes if _usable(node)]
    usable.sort(key=lambda node: (places_before.get(node.name, len(places_before)), node.name))
    return KnownNodes(height, tuple(usable)) if usable else before


class NodeDirectory:
    """The nodes of one client: fixed ones that it was given, or the network's, which it goes on learning."""

    def __init__(self, genesis: Genesis, urls: Mapping[str, str] | None, known: KnownNodes | None) -> None:
        """`known` comes with a pin. Raises CONFIGURATION_INVALID for addresses that are none, and unknown names."""
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
        self._custodians = {node.name for node in [*first.nodes, *self.known.nodes] if node.is_custodian}

    @property
    def custodians(self) -> tuple[NodeAddress, ...]:
        """The nodes among them that keep off-chain data."""
        return tuple(node for node in self.addresses if node.name in self._custodians)

    def note_failure(self) -> None:
        """Remember that a node gave no answer: it may have been removed."""
        self._failed = True

    def is_due(self, epoch: int, now_ms: int) -> bool:
        """Tell whether it is time to look who is there: never yet, other producers, a node that is gone, a minute."""
        if self.is_fixed:
            return False
        if self._learned_ms is None or epoch > self._epoch:
            return True
        return now_ms - self._learned_ms >= (RETRY_MS if self._failed else REFRESH_MS)

    def note_learned(self, epoch: int, now_ms: int) -> None:
        """Remember when the client looked, so that it does not look at every question."""
        self._learned_ms, self._epoch, self._failed = now_ms, epoch, False

    def learn(self, found: KnownNodes) -> bool:
        """Take over newer knowledge; tell whether other nodes are asked from now on."""
        if found.height <= self.known.height:
            return False
        before, self.known = self.addresses, found
        self.addresses = tuple(address_of(node) for node in found.nodes)
        self._custodians = {node.name for node in found.nodes if node.is_custodian}
        return self.addresses != before
