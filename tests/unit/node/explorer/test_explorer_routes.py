"""What the node tells the explorer: headers with their certificates, who sits where, meanings of codes, and no person."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, cast

import pytest
from aiohttp import ClientSession, web
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.block import Receipt
from consensus.chain.session_message import sign_session
from consensus.chain.transaction import sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import CANDIDATE, EPOCH, KEYS, CandidateRow, EpochRow
from contracts.vm.model.faults import VM_CODES
from node.api import create_api, server
from node.api.access import request_rate_limiter
from node.api.explorer_documents import RoundDocument
from node.api.routes.explorer import MACHINE_MEANINGS, explain_refusal
from node.api_adapters import DecodedSnapshot
from node.limits.token_buckets import Allowance
from node.limits.work_costs import ROUTE_DEFAULT_US
from node.snapshot.making import header_of_block
from node.storage.ledger_store import LedgerSnapshot
from tests.state_rows import stored
from tests.unit.node.api.small_network import NOW_MS, OWNER, PRODUCERS, SUBJECT, SmallLedger, SmallNode

Client = TestClient[web.Request, web.Application]
EVIDENCE = {"kind": "vote", "epoch": 0, "round": 7, "height": 3, "first_id": bytes(32), "second_id": bytes([1] * 32)}


class Rounds:
    """A node that is in round 9 and saw block 1 become final within 42 ms."""

    def place(self) -> RoundDocument:
        return RoundDocument(epoch=0, round=9, leader=1, certified_height=4, timed_out_count=3)

    def finality_lag_ms(self, height: int) -> int | None:
        return 42 if height == 1 else None


@dataclass
class Public:
    """A node whose explorer is public, and somebody without a session."""

    node: SmallNode
    client: Client

    async def ask(self, path: str) -> Any:
        answer = await self.client.get(f"/v1/explorer/{path}")
        assert answer.status == 200, await answer.text()
        return await answer.json()


@pytest.fixture
async def public() -> AsyncIterator[Public]:
    node = SmallNode.around(await SmallLedger().start())
    node.services = replace(node.services, public_explorer=True, rounds=Rounds())
    async with TestClient(TestServer(create_api(node.services))) as client:
        yield Public(node, client)


def a_call() -> tuple[Any, Receipt]:
    call = sign_transaction(
        SUBJECT,
        chain_id=bytes(32),
        contract="identity",
        entry="leave",
        arguments=[bytes(32)],
        valid_until_ms=NOW_MS + 60_000,
        salt=bytes(8),
    )
    return call, Receipt(txid=call.txid, ok=True, code="OK", message="", line=None, gas_used=9, events=())


async def test_a_header_tells_who_certified_it_and_how_soon_it_was_final_also_of_the_newest(public: Public) -> None:
    call, receipt = a_call()
    header = await public.node.ledger.extend([call], (receipt,))
    await public.node.ledger.extend()
    told = (await public.ask("headers?from_height=1&limit=1"))["headers"][0]
    assert told["block_id"] == sha256(encode(header)).hex()
    assert told["certificate"] == {"epoch": 0, "round": header.round, "block_id": told["block_id"], "voters": [0, 1, 2]}
    assert (told["transaction_count"], told["finality_lag_ms"]) == (1, 42)
    assert (told["missed_count"], told["missed"], told["timeout"]) == (0, [], None)
    genesis, *_, newest = (await public.ask("headers"))["headers"]
    assert newest["certificate"]["block_id"] == newest["block_id"]
    assert genesis["certificate"] is None


async def test_rounds_that_were_given_up_are_told_with_their_leaders_and_of_a_long_silence_only_the_first(
    public: Public,
) -> None:
    await public.node.ledger.extend()
    await public.node.ledger.extend(gap=2)
    told = (await public.ask("headers?from_height=2"))["headers"][0]
    assert (told["round"], told["missed_count"], told["missed"]) == (4, 2, [2, 3])
    await public.node.ledger.extend(gap=500)
    told = (await public.ask("headers?from_height=3"))["headers"][0]
    assert (told["missed_count"], len(told["missed"])) == (500, 32)


async def test_the_last_block_of_an_epoch_has_a_certificate_and_the_next_epoch_other_seats(public: Public) -> None:
    boundary = await public.node.ledger.change_epoch()
    await public.node.ledger.extend()
    told = (await public.ask(f"headers?from_height={boundary.height}"))["headers"]
    assert told[0]["is_boundary"] is True
    assert told[0]["certificate"]["block_id"] == told[0]["block_id"]
    assert told[1]["epoch"] == 1
    before, after = await public.ask("epochs/0"), await public.ask("epochs/1")
    assert [seat["key"] for seat in before["seats"]] == [key.public_key.hex() for key in PRODUCERS]
    assert {seat["key"] for seat in after["seats"]}.isdisjoint(seat["key"] for seat in before["seats"])
    assert (before["quorum"], before["faults_tolerated"], before["seats"][0]["name"]) == (3, 1, "n0")


async def test_a_block_is_found_by_its_id_and_an_unknown_one_is_not(public: Public) -> None:
    header = await public.node.ledger.extend()
    assert (await public.ask(f"headers/{sha256(encode(header)).hex()}"))["height"] == 1
    for path in (f"headers/{'00' * 32}", "epochs/7"):
        answer = await public.client.get(f"/v1/explorer/{path}")
        assert (answer.status, (await answer.json())["code"]) == (404, "NOT_FOUND")


async def test_producers_are_told_with_votes_suspension_and_evidence(public: Public) -> None:
    key = PRODUCERS[0].public_key
    fields = {"votes": ["ward"], "status": "suspended", "suspended_height": 3, "evidence": EVIDENCE}
    entry = stored(CandidateRow, name="n0", organisation="ward", **fields)
    epoch = stored(EpochRow, producers=[key])
    writes = {KEYS.flat: encode_value([key]), CANDIDATE.key(key): entry, EPOCH.flat: epoch}
    await public.node.ledger.extend(writes=writes)
    answer = await public.ask("producers")
    (told,) = answer["producers"]
    assert (told["name"], told["status"], told["seat"], told["votes"]) == ("n0", "suspended", 0, ["ward"])
    assert told["evidence"]["first_id"] == "00" * 32
    assert "signature" not in str(told)


async def test_the_status_waits_for_the_next_block(public: Public) -> None:
    asking = asyncio.create_task(public.ask("status?after_height=0&wait_ms=20000"))
    await asyncio.sleep(0)
    await public.node.ledger.extend()
    told = await asking
    assert (told["head"], told["node"], told["is_public"]) == (1, "n0", True)
    assert told["rounds"] == {"epoch": 0, "round": 9, "leader": 1, "certified_height": 4, "timed_out_count": 3}


async def test_what_anybody_is_told_says_nothing_of_a_person_or_of_what_a_transaction_says(public: Public) -> None:
    call, receipt = a_call()
    await public.node.ledger.extend([call], (receipt,))
    texts = [str(await public.ask(path)) for path in ("status", "headers", "producers", "epochs/0")]
    for secret in (SUBJECT.public_key.hex(), call.txid.hex(), "identity", "leave", "subject"):
        assert not [text for text in texts if secret in text], secret


async def test_a_node_that_is_not_public_asks_for_a_session_and_still_serves_the_page() -> None:
    node = SmallNode.around(await SmallLedger().start())
    async with TestClient(TestServer(create_api(node.services))) as client:
        answer = await client.get("/v1/explorer/status")
        assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_REQUIRED")
        assert (await client.get("/explorer/")).status == 200


@pytest.mark.parametrize("path", ["blocks", "blocks/0", "contracts", "events/page", "headers", "announcements"])
async def test_a_public_explorer_opens_no_other_route(path: str, public: Public) -> None:
    answer = await public.client.get(f"/v1/{path}")
    assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_REQUIRED")


def test_every_code_of_the_machine_has_a_meaning_and_is_explained_by_who_gives_it() -> None:
    assert set(MACHINE_MEANINGS) == VM_CODES
    assert explain_refusal("CONTRACT_DISABLED").origin == "catalogue"
    assert "work" in explain_refusal("OUT_OF_GAS").meaning
    told = explain_refusal("MEMBER_NOT_ACTIVE")
    assert (told.origin, "card" in told.next_step) == ("contract", True)
    assert explain_refusal("NEVER_HEARD_OF").next_step == ""


async def test_of_a_pruned_block_the_header_stays(public: Public) -> None:
    for _ in range(4):
        await public.node.ledger.extend()
    await public.node.ledger.store.prune(3, header_of_block)
    answer = await public.ask("headers?from_height=1")
    assert answer["earliest_height"] == 3
    counts = [header["transaction_count"] for header in answer["headers"]]
    assert counts == [None, None, 0, 0]
    assert all(header["certificate"]["voters"] == [0, 1, 2] for header in answer["headers"])


async def test_what_anybody_may_ask_reads_each_block_once_and_looks_into_no_transaction(
    public: Public, monkeypatch: pytest.MonkeyPatch
) -> None:
    call, receipt = a_call()
    for _ in range(5):
        await public.node.ledger.extend([call], (receipt,))
    read: list[int] = []
    snapshot_of = public.node.ledger.store.snapshot

    @contextmanager
    def snapshot() -> Iterator[Any]:
        with snapshot_of() as taken:
            block = taken.block
            monkeypatch.setattr(taken, "block", lambda height: (read.append(height), block(height))[1])
            yield taken

    monkeypatch.setattr(public.node.ledger.store, "snapshot", snapshot)
    monkeypatch.setattr("node.api_adapters.DecodedSnapshot.block", None)
    await public.ask("headers?from_height=1&limit=3")
    assert sorted(read) == [0, 1, 2, 3, 4, 5]
    read.clear()
    await public.ask("status")
    assert read == [5]


def test_a_block_that_is_damaged_on_the_medium_is_said_to_be() -> None:
    class Damaged:
        def block(self, _height: int) -> bytes:
            return b"\x93\xc4"

    with pytest.raises(BlockRobotError, match="block 7"):
        DecodedSnapshot(cast("LedgerSnapshot", Damaged())).head(7)


async def test_strangers_who_ask_too_much_are_slowed_down_at_every_route_of_the_explorer(
    public: Public, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(1, ROUTE_DEFAULT_US))
    for path in ("/explorer/", "/explorer/api.js", "/explorer/shared/dom.js", "/v1/explorer/status"):
        application = create_api(public.node.services)
        async with TestClient(TestServer(application)) as client:
            codes = [(await client.get(path)).status for _ in range(3)]
        assert codes == [200, 429, 429], path


async def test_a_member_is_not_slowed_down_with_the_strangers_of_her_address(
    public: Public, monkeypatch: pytest.MonkeyPatch
) -> None:
    tokens = [await session_of(public, key) for key in (SUBJECT, OWNER)]
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(1, 0))
    codes = [
        (await public.client.get("/v1/explorer/status", headers={"Authorization": f"Bearer {token}"})).status
        for token in (*tokens, "00" * 32)
    ]
    assert codes == [200, 429, 429]


async def session_of(public: Public, key: PrivateKey) -> str:
    """Open a session as a client does; return its token."""
    body = {"public_key": key.public_key.hex()}
    challenge = (await (await public.client.post("/v1/session-challenges", json=body)).json())["challenge"]
    chain_id = public.node.ledger.genesis.chain_id
    signature = sign_session(key, chain_id, public.node.services.node_name, bytes.fromhex(challenge))
    shown = {**body, "challenge": challenge, "signature": signature.hex()}
    return str((await (await public.client.post("/v1/sessions", json=shown)).json())["token"])


async def test_who_waits_for_blocks_without_a_session_takes_few_of_the_places(
    public: Public, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        server, "CONNECTIONS_MAX_COUNT", 16
    )  # half for all without a session, a quarter of it for an address
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/v1/explorer/status?wait_ms=20000"
        async with server.serve_api(create_api(public.node.services), listener, 10), ClientSession() as client:

            async def ask() -> int:
                async with client.get(url) as answer:
                    return int((await answer.json())["head"])

            asking = {asyncio.create_task(ask()) for _ in range(3)}
            done, waiting = await asyncio.wait(asking, return_when=asyncio.FIRST_COMPLETED)
            assert [task.result() for task in done] == [0]
            await public.node.ledger.extend()
            assert await asyncio.gather(*waiting) == [1, 1]
