"""A temporary measurement network: real nodes, robots with open visits."""

from __future__ import annotations

import asyncio
import secrets
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from clients.registrar.registrar import Registrar
from clients.sdk.chain.enrolment import NewMember, register_member
from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import Genesis
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.members.vouchers import Card, decode_card_code
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from consensus.records.owner_keys import open_visit_keys
from network.bench.clips_apart import ClipsApart, removed_after
from network.bench.nginx import trust_proxy
from network.cluster import READY_TIMEOUT_S, Cluster
from network.demo.tampering import drop_databases
from network.provisioning.certificate_authority import Authority
from network.provisioning.network_layout import PORTS_PER_NODE, create_network
from network.provisioning.node_certificates import get_authority

HOST = "127.0.0.1"
PURPOSE = "demo"
LIFETIME_MS = 9 * 60 * 1000
_BASE_PORTS = range(20_000, 32_000, 100)
_LISTENERS_COUNT = 3


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def find_base_port(nodes: int) -> int:
    while True:
        base = secrets.choice(_BASE_PORTS)
        ports = (base + PORTS_PER_NODE * node + offset for node in range(nodes) for offset in range(_LISTENERS_COUNT))
        if all(_is_free(port) for port in ports):
            return base


@dataclass(frozen=True, slots=True)
class LoadRobot:
    """A registered robot with an open visit, and its client."""

    key: PrivateKey
    handle: bytes
    owner: bytes
    bucket_ms: int
    client: NetworkClient

    def sign_record(self) -> Transaction:
        root = secrets.token_bytes(32)
        arguments = [
            derive_record_id(self.owner, root),
            self.owner,
            root,
            secrets.token_bytes(32),
            secrets.token_bytes(SEALED_METADATA_BYTES),
            self.bucket_ms,
            self.bucket_ms + RETENTION_DEFAULT_MS,
        ]
        return self.client.transactions.build(self.key, "records", "record", arguments, lifetime_ms=LIFETIME_MS)


class FreshNetwork:
    """A network for one measurement; use as `async with`."""

    def __init__(
        self,
        nodes: int,
        *,
        custodians: int = 2,
        faults: bool = False,
        store: str = "sqlite",
        stolen: int = 0,
        proxy: str = "",
        apart: ClipsApart | None = None,
        prepare: Callable[[Cluster], None] = lambda _cluster: None,
        start_max_s: float = READY_TIMEOUT_S,
    ) -> None:
        """`faults` allows deliberate faults; `store` is the custodians' store.

        Each custodian has its own organisation. `stolen` further nodes are in genesis but never started: an attacker
        has their certificates. `proxy` is the address of a proxy that all nodes trust. `apart`: where custodians keep their
        clips. `prepare` is called before anything starts.
        """
        self._prepare = prepare
        self._start_max_s = start_max_s
        self._apart = apart
        self._proxy = proxy
        self._stolen_count = stolen
        self._nodes_count = nodes
        self._custodians_count = min(custodians, nodes)
        self._store = store
        self._faults = faults
        self._folder = Path(tempfile.mkdtemp(prefix="blockrobot-bench-"))
        self._clients: list[NetworkClient] = []
        self._cluster: Cluster | None = None
        self._genesis: Genesis | None = None

    @property
    def genesis(self) -> Genesis:
        assert self._genesis is not None
        return self._genesis

    def authority(self, organisation: str) -> Authority:
        return get_authority(self._folder / "network", organisation)

    def stolen_folder(self, name: str) -> Path:
        return self._folder / f"stolen-{name}"

    @property
    def cluster(self) -> Cluster:
        assert self._cluster is not None
        return self._cluster

    async def __aenter__(self) -> FreshNetwork:
        try:
            place = self._folder / "network"
            self._genesis = create_network(
                place,
                nodes=self._nodes_count + self._stolen_count,
                followers=self._stolen_count,
                organisations=self._custodians_count,
                base_port=find_base_port(self._nodes_count + self._stolen_count),
                faults=self._faults,
                store=self._store,
                network=f"bench-{secrets.token_hex(4)}",
            )
            for entry in self._genesis.nodes[self._nodes_count :]:
                (place / "nodes" / entry.name).rename(self.stolen_folder(entry.name))
            if self._proxy:
                for entry in self._genesis.nodes[: self._nodes_count]:
                    trust_proxy(place / "nodes" / entry.name, self._proxy)
            self._cluster = Cluster(place)
            if self._apart is not None:
                self._apart.configure(self._cluster)
            await asyncio.to_thread(self._prepare, self._cluster)
            self._cluster.start_all()
            await self._cluster.wait_ready(timeout_s=self._start_max_s)
        except BaseException as error:
            await self._close(error)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._close(error)

    async def _close(self, error: BaseException | None) -> None:
        """`error`: what ended the measurement, which no other one replaces."""
        try:
            async with removed_after(self._folder, self._apart):
                for client in self._clients:
                    await client.close()
                if self._cluster is not None:
                    await asyncio.to_thread(self._cluster.stop_all)
                    await asyncio.to_thread(drop_databases, self._cluster)
        except BlockRobotError:
            if error is None:
                raise

    def client_of(self, number: int) -> NetworkClient:
        node = self.genesis.nodes[number % self._nodes_count]
        client = NetworkClient(self.genesis, {node.name: node.api_url})
        self._clients.append(client)
        return client

    def open_client(self) -> NetworkClient:
        client = NetworkClient(self.genesis)
        self._clients.append(client)
        return client

    async def enrol_robots(self, count: int) -> list[LoadRobot]:
        """With final open visits. Raises CALL_REFUSED and others."""
        organisation = self.genesis.organisations[0].name
        registrar = Registrar(self._folder / "network" / "organisations" / organisation, self.genesis)
        cards = [decode_card_code(registrar.issue(f"bench-{number}", "robot")) for number in range(count)]
        enrolling = [asyncio.create_task(self._enrol(number, card)) for number, card in enumerate(cards)]
        try:
            return list(await asyncio.gather(*enrolling))
        finally:
            for task in enrolling:
                task.cancel()
            await asyncio.gather(*enrolling, return_exceptions=True)

    async def _enrol(self, number: int, card: Card) -> LoadRobot:
        return await enrol_robot(self.client_of(number), card)


async def enrol_robot(client: NetworkClient, card: Card) -> LoadRobot:
    """Register with a card and open a visit. Raises CALL_REFUSED and others."""
    key, spend, view = (PrivateKey(secrets.token_bytes(32)) for _ in range(3))
    member = NewMember(identity=key, spend=spend.public_key, view=view.public_key, sealing=secrets.token_bytes(32))
    await register_member(client, card, member, [])
    visit = open_visit_keys(
        secrets.token_bytes(32),
        view.public_key,
        spend.public_key,
        chain_id=client.genesis.chain_id,
        robot=key.public_key,
    )
    now_ms = time.time_ns() // 1_000_000
    bucket_ms = now_ms - now_ms % TIME_BUCKET_MS
    arguments = [visit.owner, visit.ephemeral, visit.view_tag, bucket_ms, PURPOSE]
    await client.call(key, "records", "open_visit", arguments)
    return LoadRobot(key=key, handle=card.handle, owner=visit.owner, bucket_ms=bucket_ms, client=client)
