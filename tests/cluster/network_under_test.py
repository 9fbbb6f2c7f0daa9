"""A network of real node processes on free ports, and a client that submits to it. For the tests of this folder."""

from __future__ import annotations

import asyncio
import atexit
import secrets
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

import aiohttp
import msgspec

from consensus.chain.transaction import Transaction, sign_transaction
from consensus.primitives.keys import PrivateKey
from network.cli.cluster.status_answers import NodeStatus
from network.cluster import Cluster
from network.provisioning.network_layout import PORTS_PER_NODE, create_network
from node.config import load_config

_BASE_PORT_MIN, _BASE_PORT_MAX, _BASE_PORT_STEP = 20_000, 32_000, 100
_CLAIMS_KEPT_COUNT = 20
_claims: deque[socket.socket] = deque()
"""What holds the last port of each of the newest ranges, so that no other run of tests takes it before its nodes start."""
FINAL_TIMEOUT_S = 60.0
HTTP_TIMEOUT_S = 60.0
PLACE_WAIT_MS = 30_000
_POLL_S = 0.05


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@atexit.register
def _drop_claims() -> None:
    while _claims:
        _claims.popleft().close()


def _claim(port: int) -> socket.socket | None:
    claim = socket.socket()
    try:
        claim.bind(("127.0.0.1", port))
    except OSError:
        claim.close()
        return None
    return claim


def find_base_port(nodes: int) -> int:
    """Return a base port whose range is free: below the ports that the system hands out by itself.

    Nobody else who asks this is given it for a while, in this process or another.
    """
    while True:
        base = secrets.choice(range(_BASE_PORT_MIN, _BASE_PORT_MAX, _BASE_PORT_STEP))
        claim = _claim(base + _BASE_PORT_STEP - 1)
        if claim is None:
            continue
        if all(_is_free(base + PORTS_PER_NODE * node + offset) for node in range(nodes) for offset in range(3)):
            _claims.append(claim)
            if len(_claims) > _CLAIMS_KEPT_COUNT:
                _claims.popleft().close()
            return base
        claim.close()


def require_documented(status: dict[str, Any]) -> None:
    """Hold what a node says of itself against what `blockrobot status --json` tells programs."""
    told = {"name": "", "running": True, **status}
    assert msgspec.to_builtins(msgspec.convert(told, NodeStatus)) == told


class Runs(Protocol):
    """A network, or what stands around one."""

    async def start(self) -> None: ...

    async def close(self) -> None: ...


T = TypeVar("T", bound=Runs)


@asynccontextmanager
async def running(made: T) -> AsyncIterator[T]:
    """While inside, it runs."""
    try:
        await made.start()
        yield made
    finally:
        await made.close()


class NetworkUnderTest:
    """A cluster and one HTTP client."""

    def __init__(
        self, folder: Path, nodes: int, store: str = "sqlite", network: str = "blockrobot", organisations: int = 2
    ) -> None:
        self.folder = folder
        self.genesis = create_network(
            folder,
            nodes=nodes,
            organisations=min(organisations, nodes),
            base_port=find_base_port(nodes),
            store=store,
            network=network,
            faults=True,
        )
        self.cluster = Cluster(folder)
        self.names = self.cluster.names
        registrar = folder / "organisations" / self.genesis.organisations[0].name / "registrar.key"
        self.registrar = PrivateKey(registrar.read_bytes())
        self.http = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=HTTP_TIMEOUT_S))

    @property
    def organisation(self) -> str:
        """The first organisation, to which the robots of the tests belong."""
        return self.genesis.organisations[0].name

    @property
    def approver(self) -> PrivateKey:
        """The key of that organisation's admin, who approves the robots' empty frames."""
        return PrivateKey((self.folder / "organisations" / self.organisation / "admin.key").read_bytes())

    async def start(self) -> None:
        self.cluster.start_all()
        await self.cluster.wait_ready()

    async def close(self) -> None:
        await self.http.close()
        self.cluster.stop_all()

    def transaction(self, **changes: Any) -> Transaction:
        """A call by the registrar that every node admits and executes (the contract refuses it: nobody is there)."""
        fields: dict[str, Any] = {
            "chain_id": self.genesis.chain_id,
            "contract": "identity",
            "entry": "authenticate",
            "arguments": [secrets.token_bytes(32)],
            "valid_until_ms": time.time_ns() // 1_000_000 + 120_000,
            "salt": secrets.token_bytes(8),
        }
        return sign_transaction(self.registrar, **(fields | changes))

    def sign(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        """A call by any key."""
        return sign_transaction(
            key,
            chain_id=self.genesis.chain_id,
            contract=contract,
            entry=entry,
            arguments=arguments,
            valid_until_ms=time.time_ns() // 1_000_000 + 120_000,
            salt=secrets.token_bytes(8),
        )

    def url(self, name: str) -> str:
        """Where a node's interface is, whether it was there from the beginning or came later."""
        return f"http://127.0.0.1:{self.cluster.config(name).api_port}"

    def took_in(self, name: str) -> None:
        """Count a node that was made in the network's folder since as one of the network's."""
        self.cluster.configs[name] = load_config(self.folder / "nodes" / name)
        self.names.append(name)

    def _url(self, name: str, path: str) -> str:
        return self.url(name) + path

    async def submit(self, name: str, transactions: list[Transaction]) -> list[dict[str, Any]]:
        """Send transactions to one node; return its answer for each. Raises ClientResponseError if it takes none."""
        body = msgspec.msgpack.encode([transaction.wire for transaction in transactions])
        headers = {"Content-Type": "application/msgpack"}
        async with self.http.post(self._url(name, "/v1/transactions"), data=body, headers=headers) as response:
            response.raise_for_status()
            answer: dict[str, Any] = await response.json()
            return answer["results"]

    async def submit_anyhow(self, name: str) -> dict[str, Any]:
        """Send a transaction to a node that has to refuse it as a whole; return its problem document."""
        body = msgspec.msgpack.encode([self.transaction().wire])
        headers = {"Content-Type": "application/msgpack"}
        async with self.http.post(self._url(name, "/v1/transactions"), data=body, headers=headers) as response:
            assert response.status == 503
            problem: dict[str, Any] = await response.json(content_type=None)
            return problem

    async def place(self, name: str, txid: bytes, wait_ms: int = 5_000) -> dict[str, Any]:
        """Ask one node what became of a transaction."""
        url = self._url(name, f"/v1/transactions/{txid.hex()}?wait_ms={wait_ms}")
        async with self.http.get(url) as response:
            answer: dict[str, Any] = await response.json()
            return answer

    async def finalize(self, name: str, transaction: Transaction) -> dict[str, Any]:
        """Submit to one node and wait there until it is final; tries again while the node is away."""
        deadline = time.monotonic() + FINAL_TIMEOUT_S
        while True:
            try:
                await self.submit(name, [transaction])
                answer = await self.place(name, transaction.txid)
                if answer["status"] == "finalized":
                    return answer
            except (aiohttp.ClientError, TimeoutError):
                await asyncio.sleep(0.1)
            assert time.monotonic() < deadline, "the transaction was not final in time"

    async def status(self, name: str) -> dict[str, Any]:
        """What one node says of itself, however long it takes; nothing if it is down or paused, or does not answer."""
        deadline = time.monotonic() + FINAL_TIMEOUT_S
        while True:
            report = next(report for report in await self.cluster.status() if report.name == name)
            may_answer = report.running and not self.cluster.is_paused(name)
            if report.status is not None or not may_answer or time.monotonic() > deadline:
                require_documented(report.status or {})
                return report.status or {}
            await asyncio.sleep(_POLL_S)

    async def same_height(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """Wait until these nodes are at one height; return what they say of themselves there."""
        deadline = time.monotonic() + FINAL_TIMEOUT_S
        while True:
            said = [await self.status(name) for name in names]
            heights = {status.get("finalized_height") for status in said}
            if len(heights) == 1:
                return said
            assert time.monotonic() < deadline, f"the nodes stay at different heights: {heights}"
            await asyncio.sleep(_POLL_S)

    async def wait_height(self, name: str, height: int) -> None:
        """Wait until one node has stored a height."""
        deadline = time.monotonic() + FINAL_TIMEOUT_S
        while (await self.status(name)).get("finalized_height", -1) < height:
            assert time.monotonic() < deadline, f"{name} did not reach height {height}"
            await asyncio.sleep(_POLL_S)

    async def block_id(self, name: str, txid: bytes) -> str:
        """The block that holds a final transaction, as one node sees it."""
        answer = await self.place(name, txid, wait_ms=PLACE_WAIT_MS)
        assert answer["status"] == "finalized"
        return str(answer["block_id"])
