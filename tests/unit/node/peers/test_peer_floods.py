"""What peers bring: a false signature ends the talk, what an honest node may send does not, requests wait their turn."""

from __future__ import annotations

import asyncio

import pytest

from consensus.chain.transaction import TransactionWire, sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from node.limits.token_buckets import Allowance, Source
from node.mempool import transaction_intake
from node.mempool.transaction_intake import SIGNED_US
from node.p2p.wire import FinalizedRequest, FrameKind, HeightNotice, RequestKind, TransactionBatch
from node.peers.peer_requests import PeerRequests
from node.storage.memory_store import MemoryStore
from tests.unit.node.small_nodes import MemoryLinks, SmallNodes, make_genesis
from tests.virtual_time import in_virtual_time

NAMES = ["a", "b", "c", "d"]
STRANGER = PrivateKey(sha256(b"a stranger"))


async def _bring(crowd: SmallNodes, *wires: bytes) -> list[tuple[str, str]]:
    """Let node b pass these on to node a; return whom a cut off, and why."""
    payload = encode(TransactionBatch(transactions=wires))
    crowd.nodes["a"].peers.peer_frame("b", FrameKind.TRANSACTIONS, payload)
    await asyncio.sleep(0.2)
    return crowd.links["a"].cut


@in_virtual_time
async def test_the_first_false_signature_ends_the_talk_with_the_peer_that_passed_it_on() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    good = [crowd.transaction("identity", "authenticate", bytes([number]) * 32) for number in range(20)]
    false = encode(TransactionWire(body=good[0].body_bytes, signature=good[1].signature))
    checked = crowd.nodes["a"].intake.signatures_checked_count
    assert await _bring(crowd, false, *(item.wire for item in good[2:])) == [("b", "SIGNATURE_INVALID")]
    assert crowd.nodes["a"].intake.signatures_checked_count - checked <= 20
    await crowd.stop()


@in_virtual_time
async def test_a_sender_pays_at_each_node_for_what_one_of_them_alone_let_in(monkeypatch: pytest.MonkeyPatch) -> None:
    def send_no_transactions(self: MemoryLinks, peer: str, kind: FrameKind, payload: bytes) -> bool:
        return kind is not FrameKind.TRANSACTIONS and send(self, peer, kind, payload)

    send = MemoryLinks.send
    monkeypatch.setattr(MemoryLinks, "send", send_no_transactions)
    monkeypatch.setattr(transaction_intake, "SENDER_ALLOWANCE", Allowance(us_per_s=1, burst_us=10 * SIGNED_US))
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    many = [crowd.transaction("identity", "authenticate", bytes([number]) * 32) for number in range(10)]
    for item in many:
        await crowd.finalize("a", item)
    await crowd.wait_height(crowd.nodes["a"].feed.height, "b")
    again = crowd.transaction("identity", "authenticate", bytes(32))
    (result,) = await crowd.nodes["b"].pool.submit([again.wire], Source("loopback", "127.0.0.1"))
    assert result.error is not None
    assert result.error.code == "RATE_LIMITED"
    await crowd.stop()


@pytest.mark.parametrize("wire", [b"\x92", bytes(20_000)])
@in_virtual_time
async def test_so_does_what_is_no_transaction(wire: bytes) -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    ((peer, code),) = await _bring(crowd, wire)
    assert peer == "b"
    assert code in {"ENCODING_INVALID", "TRANSACTION_TOO_LARGE"}
    await crowd.stop()


@in_virtual_time
async def test_what_an_honest_node_may_pass_on_ends_no_talk() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    known = crowd.transaction("identity", "authenticate", bytes(32))
    await crowd.finalize("a", known)
    unknown = crowd.transaction("identity", "authenticate", bytes(32), key=STRANGER)
    body = known.body
    expired = sign_transaction(
        STRANGER,
        chain_id=body.chain_id,
        contract=body.contract,
        entry=body.entry,
        arguments=[bytes(32)],
        valid_until_ms=1,
        salt=bytes(8),
    )
    assert await _bring(crowd, known.wire, unknown.wire, expired.wire) == []
    await crowd.stop()


@in_virtual_time
async def test_nodes_pass_on_only_what_they_checked() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    good, other = (crowd.transaction("identity", "authenticate", bytes([number]) * 32) for number in range(2))
    false = encode(TransactionWire(body=good.body_bytes, signature=other.signature))
    passed, refused = await crowd.nodes["a"].pool.submit([good.wire, false])
    assert passed.error is None
    assert refused.error is not None
    assert refused.error.code == "SIGNATURE_INVALID"
    await asyncio.sleep(1)
    sent = [payload for _, _, payload in crowd.links["a"].sent]
    assert any(good.wire in payload for payload in sent), "what was checked is passed on"
    assert all(false not in payload for payload in sent)
    await crowd.stop()


@in_virtual_time
async def test_heights_beyond_the_budget_are_dropped_and_their_sender_named() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    payload = encode(HeightNotice(finalized_height=0, epoch=0))
    for _ in range(10_000):
        crowd.nodes["a"].peers.peer_frame("b", FrameKind.HEIGHT, payload)
    (row,) = crowd.nodes["a"].describe()["over_budget"]
    assert row["peer"] == "peer b"
    assert row["count"] > 1_000
    assert crowd.links["a"].cut == []
    await crowd.stop()


async def _requests(over: list[str]) -> PeerRequests:
    return PeerRequests(MemoryStore(), lambda source, _error: over.append(source))


@in_virtual_time
async def test_requests_in_a_loop_are_slowed_down_then_refused_and_other_peers_are_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("node.peers.peer_requests.REQUEST_ALLOWANCE", Allowance(us_per_s=1_000, burst_us=4_000))
    over: list[str] = []
    requests = await _requests(over)
    made: list[float] = []

    async def make() -> bytes:
        made.append(asyncio.get_running_loop().time())
        return bytes(2_048 * 512)

    began_s = asyncio.get_running_loop().time()
    await requests.answer("loud", RequestKind.FINALIZED, make)
    asked = [requests.answer("loud", RequestKind.FINALIZED, make) for _ in range(10)]
    answers = await asyncio.gather(*asked, return_exceptions=True)
    refused = [answer for answer in answers if isinstance(answer, BlockRobotError)]
    assert {error.code for error in refused} == {"RATE_LIMITED"}
    assert len(made) == 1 + len(answers) - len(refused)
    assert set(over) == {"peer loud"}
    assert await requests.answer("quiet", RequestKind.FINALIZED, make)
    assert asyncio.get_running_loop().time() - began_s < 10
    requests.stop()


@in_virtual_time
async def test_answers_with_nothing_in_them_count_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("node.peers.peer_requests.ANSWERS_KEPT_MAX_BYTES", 100 * 1_024)
    requests = await _requests([])
    for number in range(1_000):
        await requests.read_finalized(FinalizedRequest(from_height=1_000 + number, count=1))
    assert len(requests._kept) <= 200
    requests.forget_below(10_000)
    assert (len(requests._kept), requests._kept_bytes) == (0, 0)
    requests.stop()


@in_virtual_time
async def test_what_was_asked_for_lately_is_not_read_again() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    for number in range(4):
        await crowd.finalize("a", crowd.transaction("identity", "authenticate", bytes([number]) * 32))
    await asyncio.sleep(1)
    peers, body = crowd.nodes["a"].peers, encode(FinalizedRequest(from_height=1, count=1))
    first = await peers.peer_request("b", RequestKind.FINALIZED, body)
    assert await peers.peer_request("c", RequestKind.FINALIZED, body) is first
    await crowd.stop()
