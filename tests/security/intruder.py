"""An HTTP client that says anything to a node, and checks that every refusal is a plain one that changed nothing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import time
from collections.abc import AsyncIterator
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import aiohttp
import msgspec

from clients.sdk.chain.enrolment import NewMember, registration_arguments
from consensus.chain.session_message import sign_session
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.errors import CATALOGUE
from consensus.members.vouchers import Card, issue_card
from consensus.primitives.keys import PrivateKey
from tests.cluster.network_under_test import NetworkUnderTest

PROBLEM = "application/problem+json"
MSGPACK = "application/msgpack"
SETTLE_TIMEOUT_S = 10.0
BUDGET_ASKS_MAX_COUNT = 20


def now_ms() -> int:
    return time.time_ns() // 1_000_000


def new_key() -> PrivateKey:
    return PrivateKey(secrets.token_bytes(31) + b"\x01")


def new_member() -> NewMember:
    return NewMember(
        identity=new_key(), spend=new_key().public_key, view=new_key().public_key, sealing=secrets.token_bytes(32)
    )


def assert_plain(problem: dict[str, Any], code: str) -> None:
    """A refusal has its code of the catalogue, a sentence, a next step, and nothing of the program's inside."""
    assert problem["code"] == code, problem
    entry = CATALOGUE[code]
    assert problem["status"] == entry.status
    assert problem["next_step"] == entry.next_step
    assert problem["detail"].endswith((".", "?"))
    for inside in ("Traceback", 'File "', "Error(", "0x", "/node/", ".py"):
        assert inside not in json.dumps(problem)


class Intruder:
    """Requests to one node, good and bad."""

    def __init__(self, network: NetworkUnderTest) -> None:
        self.network = network
        self.genesis = network.genesis
        self.node = network.names[0]
        self.http = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=20))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.http.close()

    def url(self, path: str, node: str | None = None) -> str:
        return self.genesis.node(node or self.node).api_url + path

    async def ask(self, method: str, path: str, **options: Any) -> tuple[int, str, bytes]:
        """Return status, media type and body of any request."""
        node = options.pop("node", None)
        async with self.http.request(method, self.url(path, node), **options) as response:
            return response.status, response.content_type, await response.read()

    async def refused(self, code: str, method: str, path: str, **options: Any) -> dict[str, Any]:
        """Make a request that must be refused with this code, plainly."""
        status, media_type, body = await self.ask(method, path, **options)
        assert media_type == PROBLEM, (status, media_type, body[:200])
        problem: dict[str, Any] = json.loads(body)
        assert status == problem["status"]
        assert_plain(problem, code)
        return problem

    async def raw(self, data: bytes, timeout_s: float = 5.0) -> bytes:
        """Send bytes to the node's port and return all that comes back until it closes or falls silent."""
        address = urlsplit(self.url(""))
        reader, writer = await asyncio.open_connection(address.hostname, address.port, limit=1 << 20)
        answer = b""
        try:
            with contextlib.suppress(ConnectionError):
                writer.write(data)
                await writer.drain()
            with contextlib.suppress(TimeoutError, ConnectionError):
                async with asyncio.timeout(timeout_s):
                    while part := await reader.read(65536):
                        answer += part
                        head, found, body = answer.partition(b"\r\n\r\n")
                        if found and len(body) >= _content_length(head):
                            break
        finally:
            writer.close()
        return answer

    # Transactions

    async def submit(self, *wires: bytes, node: str | None = None) -> list[dict[str, Any]]:
        body = msgspec.msgpack.encode(list(wires))
        status, _, answer = await self.ask(
            "POST", "/v1/transactions", data=body, headers={"Content-Type": MSGPACK}, node=node
        )
        assert status == 200, answer
        results: list[dict[str, Any]] = json.loads(answer)["results"]
        return results

    async def rejected(self, code: str, wire: bytes, node: str | None = None) -> None:
        """Submit a wire that must be rejected with this code, plainly."""
        (result,) = await self.submit(wire, node=node)
        assert result["status"] == "rejected", result
        assert_plain(result["error"], code)

    def call(self, key: PrivateKey, contract: str, entry: str, *arguments: Any, **changes: Any) -> Transaction:
        fields: dict[str, Any] = {
            "chain_id": self.genesis.chain_id,
            "valid_until_ms": now_ms() + 60_000,
            "salt": secrets.token_bytes(8),
        }
        return sign_transaction(key, contract=contract, entry=entry, arguments=list(arguments), **(fields | changes))

    async def final(self, transaction: Transaction) -> dict[str, Any]:
        """Submit a transaction that is admitted; return its receipt once it is final on every node."""
        await self.network.finalize(self.node, transaction)
        answers = [await self.network.place(name, transaction.txid, 10_000) for name in self.network.names]
        assert {answer["status"] for answer in answers} == {"finalized"}
        receipt: dict[str, Any] = answers[0]["receipt"]
        return receipt

    # Enrolment

    def card(self, **changes: Any) -> Card:
        fields: dict[str, Any] = {
            "chain_id": self.genesis.chain_id,
            "handle": secrets.token_bytes(32),
            "card_secret": new_key().secret,
            "role": "subject",
            "not_after_ms": now_ms() + 3_600_000,
        }
        return issue_card(changes.pop("registrar", self.network.registrar), **(fields | changes))

    def registration(self, card: Card, member: NewMember) -> Transaction:
        arguments = registration_arguments(card, member, self.genesis.chain_id, ["demo"])
        return self.call(member.identity, "identity", "register", *arguments)

    async def enrol(self, role: str = "subject") -> NewMember:
        """Register somebody new."""
        member = new_member()
        receipt = await self.final(self.registration(self.card(role=role), member))
        assert receipt["ok"], receipt
        return member

    # Sessions

    async def challenge(self, key: PrivateKey, node: str | None = None) -> bytes:
        body = await self._served("/v1/session-challenges", {"public_key": key.public_key.hex()}, node)
        return bytes.fromhex(body["challenge"])

    def answer_to(self, key: PrivateKey, challenge: bytes, node: str | None = None) -> dict[str, str]:
        signature = sign_session(key, self.genesis.chain_id, node or self.node, challenge)
        return {"public_key": key.public_key.hex(), "challenge": challenge.hex(), "signature": signature.hex()}

    async def session(self, key: PrivateKey, node: str | None = None) -> dict[str, str]:
        """Open a session; return the header that carries its token."""
        answer = self.answer_to(key, await self.challenge(key, node), node)
        return {"Authorization": "Bearer " + (await self._served("/v1/sessions", answer, node))["token"]}

    async def _served(self, path: str, content: dict[str, str], node: str | None) -> dict[str, str]:
        """Ask again while the address has no budget left: a test before may have used it up."""
        for _ in range(BUDGET_ASKS_MAX_COUNT):
            status, _, body = await self.ask("POST", path, json=content, node=node)
            if status != 429:
                break
            await asyncio.sleep(1)
        assert status == 200, body
        served: dict[str, str] = json.loads(body)
        return served


def _content_length(head: bytes) -> int:
    for line in head.lower().split(b"\r\n"):
        if line.startswith(b"content-length:"):
            return int(line.partition(b":")[2])
    return 1 << 30


async def settled(network: NetworkUnderTest) -> dict[str, str]:
    """Return every node's state root once no node has anything waiting and all agree."""
    deadline = time.monotonic() + SETTLE_TIMEOUT_S
    while True:
        status = [report.status or {} for report in await network.cluster.status()]
        roots = {one["name"]: one["state_root"] for one in status if one}
        agreed = len(roots) == len(network.names) and len(set(roots.values())) == 1
        if agreed and all(one["mempool"] == 0 for one in status):
            return roots
        assert time.monotonic() < deadline, "the nodes do not come to rest"
        await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def nothing_changes(network: NetworkUnderTest) -> AsyncIterator[None]:
    """What happens inside leaves every node's state root and mempool as they were."""
    before = await settled(network)
    yield
    status = [report.status or {} for report in await network.cluster.status()]
    assert {one["name"]: one["mempool"] for one in status} == dict.fromkeys(network.names, 0)
    assert await settled(network) == before
