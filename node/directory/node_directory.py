"""The network's nodes, organisations and revoked certificates, by the finalized state."""

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
    """A node: organisation, address, keys (33 bytes, or empty), and whether it is active."""

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
        return self.host, self.p2p_port


@dataclass(frozen=True, slots=True)
class DirectoryOrganisation:
    """An organisation: its CA certificate (PEM) and whether it is active."""

    name: str
    ca_certificate: str
    is_active: bool = True


@dataclass(frozen=True)
class DirectoryContent:
    """The directory at one height; `nodes` and `organisations` include removed ones, by name."""

    height: int
    nodes: Mapping[str, DirectoryNode]
    organisations: Mapping[str, DirectoryOrganisation]
    revoked: frozenset[tuple[str, int]] = field(default_factory=frozenset)
    """Pairs of an organisation's name and the serial number of a certificate of its CA."""

    @cached_property
    def active(self) -> Mapping[str, DirectoryNode]:
        """Nodes that are active and whose organisation is, in name order."""
        return {name: node for name, node in sorted(self.nodes.items()) if self.is_active(node)}

    def is_active(self, node: DirectoryNode) -> bool:
        organisation = self.organisations.get(node.organisation)
        return node.is_active and organisation is not None and organisation.is_active

    def says_the_same(self, other: DirectoryContent) -> bool:
        mine = (self.nodes, self.organisations, self.revoked)
        return mine == (other.nodes, other.organisations, other.revoked)


def content_of_genesis(genesis: Genesis) -> DirectoryContent:
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
    """None without membership. Raises STORAGE_DAMAGED for impossible entries."""
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
    """The directory of one node: its current content and its listeners."""

    def __init__(self, beginning: DirectoryContent) -> None:
        self._content = beginning
        self._hinted_height = beginning.height
        self._is_beginning = True
        self._listeners: list[Callable[[Directory], None]] = []
        self._names_by_producer = _names_by_producer(beginning)

    @classmethod
    def of_genesis(cls, genesis: Genesis) -> Directory:
        return cls(content_of_genesis(genesis))

    @property
    def content(self) -> DirectoryContent:
        return self._content

    @property
    def height(self) -> int:
        return self._content.height

    @property
    def names(self) -> list[str]:
        return list(self._content.active)

    def node(self, name: str) -> DirectoryNode | None:
        return self._content.active.get(name)

    def name_of_producer(self, key: bytes) -> str | None:
        """Return the node with this producer key (33 bytes), current or recent, or None."""
        return self._names_by_producer.get(key)

    @property
    def custodians(self) -> Mapping[str, bytes]:
        """Keys (33 bytes) by node."""
        return {name: node.custodian_key for name, node in self._content.active.items() if node.custodian_key}

    def add_listener(self, listener: Callable[[Directory], None]) -> None:
        self._listeners.append(listener)

    def remove_listener(self, listener: Callable[[Directory], None]) -> None:
        self._listeners = [item for item in self._listeners if item != listener]

    def refresh(self, state: Scanner, height: int) -> bool:
        """Reread the state unless below the hint, notify listeners, return whether it changed. Raises STORAGE_DAMAGED."""
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
        if height < self._hinted_height:
            return False
        return self._is_beginning or any(key.startswith(_MEMBERSHIP_KEYS) for keys in writes for key in keys)


def _names_by_producer(content: DirectoryContent) -> dict[bytes, str]:
    nodes = sorted(content.nodes.values(), key=lambda node: (content.is_active(node), node.name))
    return {node.producer_key: node.name for node in nodes if node.producer_key}
