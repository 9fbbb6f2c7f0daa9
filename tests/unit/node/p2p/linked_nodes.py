"""Nodes that are nothing but their links, in one process, over real TLS on loopback. For the tests of this folder."""

from __future__ import annotations

import asyncio
import datetime as dt
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from consensus.chain.genesis import Genesis
from consensus.primitives.encoding import encode_value
from consensus.state.membership import NODE, ORGANISATION, REVOKED
from network.provisioning.certificate_authority import Authority, create_authority, issue_node_certificate
from node.config import NodeConfig
from node.directory.node_directory import Directory, content_of_genesis
from node.limits.token_buckets import Source
from node.p2p.network import PeerNetwork, wall_now_ms
from node.p2p.wire import FrameKind, RequestKind
from tests.cluster.network_under_test import find_base_port
from tests.unit.node.small_genesis import node_entry, small_genesis

WAIT_S = 10.0


class Membership:
    """A state with what the contract `membership` writes, to be changed at will."""

    def __init__(self) -> None:
        self.height = 0
        self.entries: dict[bytes, bytes] = {}

    def scan(self, prefix: bytes, limit: int) -> Any:
        found = [(key, value) for key, value in sorted(self.entries.items()) if key.startswith(prefix)]
        return iter(found[:limit])

    def put_organisation(self, name: str, ca_certificate: str, status: str = "active") -> None:
        entry = {"name": name, "ca_certificate": ca_certificate, "status": status, "since_height": self.height}
        self.entries[ORGANISATION.key(name)] = encode_value(entry)

    def put_node(self, name: str, organisation: str, port: int, status: str = "active", **changes: Any) -> None:
        entry = {
            "name": name,
            "organisation": organisation,
            "host": "127.0.0.1",
            "p2p_port": port,
            "api_url": f"http://127.0.0.1:{port + 1}",
            "producer_key": b"",
            "producer_possession": b"",
            "custodian_key": b"",
            "status": status,
            "since_height": self.height,
        }
        self.entries[NODE.key(name)] = encode_value(entry | changes)

    def revoke(self, organisation: str, serial: int) -> None:
        self.entries[REVOKED.key(organisation, serial)] = encode_value({"height": self.height})


class Listener:
    """What a node hears on its links, with somebody waiting for it."""

    def __init__(self) -> None:
        self.connected: set[str] = set()
        self.frames: list[tuple[str, FrameKind, bytes]] = []
        self.links_made: list[str] = []
        self.over: list[str] = []
        self._changed = asyncio.Condition()

    def finalized_height(self) -> int:
        return 7

    def peer_connected(self, peer: str, finalized_height: int) -> None:
        assert finalized_height == 7
        self.connected.add(peer)
        self.links_made.append(peer)

    def peer_disconnected(self, peer: str) -> None:
        self.connected.discard(peer)

    def peer_frame(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        self.frames.append((peer, kind, payload))

    async def peer_request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        return body

    def on_over_budget(self, source: Source, _wait_s: float) -> None:
        self.over.append(str(source))


async def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    async with asyncio.timeout(WAIT_S):
        while not condition():  # noqa: ASYNC110 - what is waited for is many things, none of which tells
            await asyncio.sleep(0.005)


class LinkedNode:
    """One node's links: its directory, its certificate files, what it hears."""

    def __init__(self, config: NodeConfig, genesis: Genesis) -> None:
        self.config = config
        self.heard = Listener()
        self.directory = Directory(content_of_genesis(genesis))
        self.clock_offset_ms = 0
        self.links = PeerNetwork(
            config, genesis, self.heard, directory=self.directory, clock=lambda: wall_now_ms() + self.clock_offset_ms
        )

    def refused(self) -> dict[str, str]:
        """Whom this node refuses, by code."""
        return {row["peer"]: row["code"] for row in self.links.describe()["refused_peers"]}

    def refused_by(self) -> dict[str, str]:
        """Who refuses this node, by code."""
        return {row["peer"]: row["code"] for row in self.links.describe()["refused_by"]}


class LinkedNodes:
    """Several of them, of one or two organisations, and the state that they all follow."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authorities = {name: create_authority(name) for name in ("hospital", "university")}
        self.state = Membership()
        self.ports: dict[str, int] = {}
        self.serials: dict[str, int] = {}
        self.organisations: dict[str, str] = {}
        self.nodes: dict[str, LinkedNode] = {}
        self.genesis: Genesis | None = None
        self._stack = AsyncExitStack()
        for name, authority in self.authorities.items():
            self.state.put_organisation(name, authority.certificate_pem)

    async def close(self) -> None:
        await self._stack.aclose()

    def _genesis_of(self, names: dict[str, str]) -> Genesis:
        entries = tuple(node_entry(name, names[name], self.ports[name]) for name in names)
        return replace(small_genesis(self.authorities), nodes=entries)

    def certify(self, name: str, organisation: str, **options: Any) -> int:
        """Write a node's certificate and key; return the serial number."""
        authority: Authority = options.pop("authority", self.authorities[organisation])
        certificate = issue_node_certificate(authority, name, **options)
        folder = self.folder / name
        folder.mkdir(exist_ok=True)
        (folder / "tls.key.pem").write_bytes(certificate.key_pem)
        (folder / "tls.crt.pem").write_bytes(certificate.certificate_pem)
        self.serials[name] = certificate.serial
        return certificate.serial

    def config(self, name: str) -> NodeConfig:
        port, folder = self.ports[name], self.folder / name
        return NodeConfig(
            data_dir=folder,
            name=name,
            genesis_path=folder / "genesis.json",
            host="127.0.0.1",
            p2p_port=port,
            api_port=port + 1,
            operator_port=port + 2,
            tls_certificate_path=folder / "tls.crt.pem",
            tls_key_path=folder / "tls.key.pem",
            producer_key_path=None,
            custodian_key_path=None,
            custody_store="sqlite",
            log_level="info",
            organisation=self.organisations[name],
        )

    def declare(self, name: str, organisation: str, status: str = "active") -> None:
        """Let the state name a node, at the port that it has or a new one."""
        self.ports.setdefault(name, find_base_port(1))
        self.organisations[name] = organisation
        self.state.put_node(name, organisation, self.ports[name], status)

    def prepare(self, names: dict[str, str]) -> Genesis:
        """Name these nodes in the genesis file, and give them certificates."""
        for name, organisation in names.items():
            self.declare(name, organisation)
            if name not in self.serials:
                self.certify(name, organisation)
        self.genesis = self.genesis or self._genesis_of(names)
        return self.genesis

    async def start(self, names: dict[str, str]) -> None:
        """Start these nodes, with certificates unless they have some; the first ones are those of the genesis file."""
        genesis = self.prepare(names)
        for name in names:
            node = LinkedNode(self.config(name), genesis)
            await node.links.start()
            self._stack.push_async_callback(node.links.stop)
            self.nodes[name] = node

    def finalize(self) -> None:
        """Let all nodes know the state as it is now, as a final block would."""
        self.state.height += 1
        for node in self.nodes.values():
            node.directory.refresh(self.state, self.state.height)


def days(number: float) -> dt.timedelta:
    return dt.timedelta(days=number)
