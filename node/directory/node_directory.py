"""Who the nodes of the network are, by the finalized state.

The genesis file is only the beginning: from then on the contract `membership` names nodes, organisations with their
certificate authorities, and revoked certificates. All nodes read the same state, so a change counts from the same
height everywhere. No I/O here; who needs to act on a change is a listener.

A node that joins an old network may begin with a hint: what another node's directory said at some height. The hint
holds until the node's own chain has reached that height.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import structlog

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.state.keys import Scanner, flat_prefix
from consensus.state.membership import MEMBERSHIP, NODE, ORGANISATION, REVOKED, NodeRow, OrganisationRow

ENTRIES_MAX_COUNT = 100_000
ACTIVE = "active"
_MEMBERSHIP_KEYS = flat_prefix(MEMBERSHIP)

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class DirectoryNode:
    """A node: who runs it, where it is, its keys (33 bytes, or empty), and whether it still belongs to the network."""

    name: str
    organisation: str
    host: str
    p2p_port: int
    api_url: str
    producer_key: bytes
    custodian_key: bytes
    is_active: bool = True
    since_height: int = 0

    @property
    def address(self) -> tuple[str, int]:
        """Where its peers reach it."""
        return self.host, self.p2p_port


@dataclass(frozen=True, slots=True)
class DirectoryOrganisation:
    """An organisation: its CA certificate (PEM) and whether it still belongs to the network."""

    name: str
    ca_certificate: str
    is_active: bool = True


@dataclass(frozen=True)
class DirectoryContent:
    """All that the directory says at one height. `nodes` and `organisations` hold removed ones too, by name."""

    height: int
    nodes: Mapping[str, DirectoryNode]
    organisations: Mapping[str, DirectoryOrganisation]
    revoked: frozenset[tuple[str, int]] = field(default_factory=frozenset)
    """Pairs of an organisation's name and the serial number of a certificate of its CA."""

    @cached_property
    def active(self) -> Mapping[str, DirectoryNode]:
        """The nodes that belong to the network: they are active, and so is their organisation. In name order."""
        return {name: node for name, node in sorted(self.nodes.items()) if self.is_active(node)}

    def is_active(self, node: DirectoryNode) -> bool:
        """Tell whether a node and its organisation belong to the network."""
        organisation = self.organisations.get(node.organisation)
        return node.is_active and organisation is not None and organisation.is_active

    def says_the_same(self, other: DirectoryContent) -> bool:
        """Tell whether two contents differ in nothing but the height."""
        mine = (self.nodes, self.organisations, self.revoked)
        return mine == (other.nodes, other.organisations, other.revoked)


def content_of_genesis(genesis: Genesis) -> DirectoryContent:
    """Return what the genesis file says."""
    return DirectoryContent(
        height=0,
        nodes={
            node.name: DirectoryNode(
                name=node.name,
                organisation=node.organisation,
                host=node.host,
                p2p_port=node.p2p_port,
                api_url=node.api_url,
                producer_key=node.producer_key,
                custodian_key=node.custodian_key,
            )
            for node in genesis.nodes
        },
        organisations={
            item.name: DirectoryOrganisation(name=item.name, ca_certificate=item.ca_certificate)
            for item in genesis.organisations
        },
    )


def read_content(state: Scanner, height: int) -> DirectoryContent | None:
    """Return what the state of this height says, or None if it holds no membership at all.

    Raises STORAGE_DAMAGED for entries that the contract cannot have written.
    """
    try:
        nodes = [_node(row) for _, row in NODE.rows(state, limit=ENTRIES_MAX_COUNT)]
        organisations = [_organisation(row) for _, row in ORGANISATION.rows(state, limit=ENTRIES_MAX_COUNT)]
        revoked = frozenset(
            (organisation.decode(), int.from_bytes(serial, "big"))
            for (organisation, serial), _ in REVOKED.rows(state, limit=ENTRIES_MAX_COUNT)
        )
    except (BlockRobotError, UnicodeDecodeError) as error:
        raise BlockRobotError("STORAGE_DAMAGED", f"The membership in the state cannot be read: {error}") from None
    if not nodes or not organisations:
        return None
    return DirectoryContent(
        height=height,
        nodes={node.name: node for node in nodes},
        organisations={item.name: item for item in organisations},
        revoked=revoked,
    )


def _node(row: NodeRow) -> DirectoryNode:
    return DirectoryNode(
        name=row.name,
        organisation=row.organisation,
        host=row.host,
        p2p_port=row.p2p_port,
        api_url=row.api_url,
        producer_key=row.producer_key,
        custodian_key=row.custodian_key,
        is_active=row.status == ACTIVE,
        since_height=row.since_height,
    )


def _organisation(row: OrganisationRow) -> DirectoryOrganisation:
    return DirectoryOrganisation(name=row.name, ca_certificate=row.ca_certificate, is_active=row.status == ACTIVE)


class Directory:
    """The directory of one node: its content now, and who wants to know of changes."""

    def __init__(self, beginning: DirectoryContent) -> None:
        self._content = beginning
        self._hinted_height = beginning.height
        self._is_beginning = True
        self._listeners: list[Callable[[Directory], None]] = []
        self._names_by_producer = _names_by_producer(beginning)

    @classmethod
    def of_genesis(cls, genesis: Genesis) -> Directory:
        """Return the directory as the genesis file has it."""
        return cls(content_of_genesis(genesis))

    @property
    def content(self) -> DirectoryContent:
        """All that it says now; a value that does not change."""
        return self._content

    @property
    def height(self) -> int:
        """The height as of which it speaks."""
        return self._content.height

    @property
    def names(self) -> list[str]:
        """The names of the nodes that belong to the network, sorted."""
        return list(self._content.active)

    def node(self, name: str) -> DirectoryNode | None:
        """Return the node of this name if it belongs to the network."""
        return self._content.active.get(name)

    def name_of_producer(self, key: bytes) -> str | None:
        """Return the name of the node that has this producer key (33 bytes), or had it lately, or None."""
        return self._names_by_producer.get(key)

    @property
    def custodians(self) -> frozenset[str]:
        """The names of the nodes that keep off-chain data."""
        return frozenset(name for name, node in self._content.active.items() if node.custodian_key)

    def add_listener(self, listener: Callable[[Directory], None]) -> None:
        """Call `listener` after each change of what the directory says."""
        self._listeners.append(listener)

    def remove_listener(self, listener: Callable[[Directory], None]) -> None:
        """Call `listener` no more; harmless if it never was one."""
        self._listeners = [item for item in self._listeners if item != listener]

    def refresh(self, state: Scanner, height: int) -> bool:
        """Read the finalized state of this height again; tell whether anything changed, after telling the listeners.

        A state below the height of the hint is passed over. Raises STORAGE_DAMAGED.
        """
        if height < self._hinted_height:
            return False
        content = read_content(state, height)
        if content is None:
            return False
        before, self._content = self._content, content
        self._is_beginning = False
        if before.says_the_same(content):
            return False
        self._names_by_producer |= _names_by_producer(content)
        log.info("directory_changed", height=height, nodes=len(content.active), revoked=len(content.revoked))
        for listener in self._listeners:
            listener(self)
        return True

    def needs_refresh(self, writes: Iterable[Mapping[bytes, Any]], height: int) -> bool:
        """Tell whether blocks up to `height` that wrote this may have changed what the directory says."""
        if height < self._hinted_height:
            return False
        return self._is_beginning or any(key.startswith(_MEMBERSHIP_KEYS) for keys in writes for key in keys)


def _names_by_producer(content: DirectoryContent) -> dict[bytes, str]:
    """Map producer keys to names; where an active and a removed node share a key, the active one counts."""
    nodes = sorted(content.nodes.values(), key=lambda node: (content.is_active(node), node.name))
    return {node.producer_key: node.name for node in nodes if node.producer_key}
