"""What each route answers, from one small ledger."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import msgspec
import pytest

from consensus.api_documents import EPOCHS_PAGE_MAX_COUNT
from consensus.chain.block import ContractEvent, EpochProof, FinalityProof, QuorumCertificate, Receipt
from consensus.chain.genesis import genesis_from_json
from consensus.chain.light_client import LightClient
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.primitives.encoding import decode, decode_value, encode, encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import Proof
from consensus.records.clips import ClipDownload, check_clip_upload
from node.limits.token_buckets import Source, over_budget
from tests.unit.node.api.small_network import (
    ACCESS_ID,
    NOW_MS,
    OTHER_OWNER,
    OWNER,
    RECORD_ID,
    ROBOT,
    SUBJECT,
    SmallNode,
    flat,
    make_upload,
)


def make_transaction(node: SmallNode, salt: int = 0) -> Transaction:
    return sign_transaction(
        SUBJECT,
        chain_id=node.ledger.genesis.chain_id,
        contract="access",
        entry="request",
        arguments=[],
        valid_until_ms=NOW_MS + 60_000,
        salt=salt.to_bytes(8, "big"),
    )


def body_of(*wires: bytes) -> bytes:
    return msgspec.msgpack.encode(list(wires))


def proof_of(document: dict[str, Any]) -> FinalityProof:
    return FinalityProof(
        header_bytes=bytes.fromhex(document["header"]),
        child_header_bytes=bytes.fromhex(document["child_header"]),
        child_qc=decode(bytes.fromhex(document["child_qc"]), QuorumCertificate),
        through=tuple(bytes.fromhex(header) for header in document["through"]),
    )


async def test_anyone_follows_the_chain_through_its_epochs(api: Any, node: SmallNode) -> None:
    assert await (await api.get("/v1/epochs")).json() == {"epochs": []}
    for _ in range(EPOCHS_PAGE_MAX_COUNT + 2):
        await node.ledger.change_epoch()
    light_client = LightClient(node.ledger.genesis)
    for expected in (EPOCHS_PAGE_MAX_COUNT, 2, 0):
        answer = await (await api.get(f"/v1/epochs?after={light_client.epoch.number}")).json()
        assert len(answer["epochs"]) == expected
        for proof in answer["epochs"]:
            light_client.advance(decode(bytes.fromhex(proof), EpochProof))
    assert light_client.epoch == node.ledger.epoch
    assert light_client.header == node.ledger.header


async def test_anyone_reads_the_genesis_file(api: Any, node: SmallNode) -> None:
    answer = await api.get("/v1/genesis")
    assert genesis_from_json(await answer.text()) == node.ledger.genesis


async def test_a_batch_gets_one_result_for_each_transaction_in_order(api: Any, node: SmallNode) -> None:
    transaction = make_transaction(node)
    answer = await api.post("/v1/transactions", data=body_of(transaction.wire, b"rubbish"))
    first, second = (await answer.json())["results"]
    assert first == {"txid": transaction.txid.hex(), "status": "accepted", "error": None}
    assert (second["txid"], second["status"], second["error"]["code"]) == (None, "rejected", "ENCODING_INVALID")


@pytest.mark.parametrize("body", [b"", b"\x00", body_of(), body_of(*[b"x"] * 257), b"\x91" * 10_000])
async def test_a_body_that_is_no_batch_is_refused(api: Any, body: bytes) -> None:
    answer = await api.post("/v1/transactions", data=body)
    assert (answer.status, (await answer.json())["code"]) == (400, "REQUEST_INVALID")


async def test_a_transaction_is_unknown_then_pending_then_final_or_expired(api: Any, node: SmallNode) -> None:
    transaction = make_transaction(node)
    path = f"/v1/transactions/{transaction.txid.hex()}"
    assert (await (await api.get(path)).json())["status"] == "unknown"
    await api.post("/v1/transactions", data=body_of(transaction.wire))
    assert (await (await api.get(path)).json())["status"] == "pending"
    await node.pool.finalize("NOT_TODAY")
    state = await (await api.get(path)).json()
    assert (state["status"], state["height"], state["index"]) == ("finalized", 1, 0)
    assert state["receipt"] == {"ok": False, "code": "NOT_TODAY", "message": "", "line": None, "gas_used": 7}
    assert state["evidence"] is None
    node.pool.expired.add(bytes(32))
    assert (await (await api.get(f"/v1/transactions/{bytes(32).hex()}")).json())["status"] == "expired"


async def test_a_held_back_answer_is_given_at_the_moment_of_finality(api: Any, node: SmallNode) -> None:
    transaction = make_transaction(node)
    await api.post("/v1/transactions", data=body_of(transaction.wire))
    waiting = asyncio.create_task(api.get(f"/v1/transactions/{transaction.txid.hex()}?wait_ms=30000"))
    await node.pool.waited_for.wait()
    await node.pool.finalize()
    async with asyncio.timeout(5):
        assert (await (await waiting).json())["status"] == "finalized"


async def test_finality_is_null_at_genesis_and_proved_above(api: Any, node: SmallNode, open_session: Any) -> None:
    headers = await open_session(OWNER)
    assert await (await api.get("/v1/finality", headers=headers)).json() == {"height": 0, "finality": None}
    expected = await node.ledger.extend()
    document = await (await api.get("/v1/finality", headers=headers)).json()
    assert LightClient(node.ledger.genesis).accept(proof_of(document["finality"])) == expected


async def test_headers_follow_each_other(api: Any, node: SmallNode, open_session: Any) -> None:
    for _ in range(4):
        await node.ledger.extend()
    headers = await open_session(SUBJECT)
    document = await (await api.get("/v1/headers?from_height=1&limit=3", headers=headers)).json()
    assert len(document["headers"]) == 3
    assert document["headers"][0] != document["headers"][1]


async def test_state_proofs_show_presence_and_absence_under_one_root(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    await node.ledger.extend(writes={flat("records", b"new"): encode_value(5)})
    keys = [flat("records", b"new"), flat("records", b"none")]
    headers = await open_session(SUBJECT)
    answer = await api.post("/v1/state-proofs", json={"keys": [key.hex() for key in keys]}, headers=headers)
    document = await answer.json()
    light_client, values = LightClient(node.ledger.genesis), []
    for key, proved in zip(keys, document["proofs"], strict=True):
        value = None if proved["value"] is None else bytes.fromhex(proved["value"])
        proof = decode(bytes.fromhex(proved["proof"]), Proof)
        values.append(light_client.verify_state(proof_of(document["finality"]), key, value, proof))
    assert values == [5, None]


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"keys": []},
        {"keys": ["zz"]},
        {"keys": ["ABCDEF"]},
        {"keys": ["00" * 162]},
        {"keys": ["aabbcc"] * 129},
        {"keys": ["aabbcc"], "more": 1},
        {"keys": "aabbcc"},
    ],
)
async def test_a_request_for_proofs_of_another_form_is_refused(api: Any, open_session: Any, document: Any) -> None:
    answer = await api.post("/v1/state-proofs", json=document, headers=await open_session(SUBJECT))
    assert (answer.status, (await answer.json())["code"]) == (400, "REQUEST_INVALID")


async def test_a_view_answers_an_encoded_value(api: Any, open_session: Any) -> None:
    document = {"contract": "echo", "view": "back", "args": encode_value([1, b"x"]).hex()}
    answer = await (await api.post("/v1/queries", json=document, headers=await open_session(OWNER))).json()
    assert (decode_value(bytes.fromhex(answer["result"])), answer["height"]) == ([1, b"x"], 0)


@pytest.mark.parametrize(
    ("contract", "view", "arguments", "code"),
    [
        ("echo", "other", encode_value([]), "CALL_REFUSED"),
        ("none", "back", encode_value([]), "TRANSACTION_CONTRACT_UNKNOWN"),
        ("echo", "back", encode_value(1), "REQUEST_INVALID"),
        ("echo", "back", b"\xc1", "ENCODING_INVALID"),
        ("echo", "back", b"\xcc\x01", "ENCODING_NOT_CANONICAL"),
    ],
)
async def test_a_query_that_fails_says_why(
    api: Any, open_session: Any, contract: str, view: str, arguments: bytes, code: str
) -> None:
    document = {"contract": contract, "view": view, "args": arguments.hex()}
    answer = await api.post("/v1/queries", json=document, headers=await open_session(SUBJECT))
    assert (await answer.json())["code"] == code


async def test_who_asks_more_views_at_once_than_may_wait_of_one_source_is_named(
    node: SmallNode, api: Any, open_session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Source] = []

    async def run_view(*arguments: Any) -> bytes:
        asked.append(arguments[-1])
        raise over_budget(str(arguments[-1]), 1.0)

    over: list[str] = []
    monkeypatch.setattr(node.services.views, "run_view", run_view)
    object.__setattr__(node.services, "on_over_budget", lambda source, _error: over.append(source))
    document = {"contract": "echo", "view": "back", "args": encode_value([]).hex()}
    answer = await api.post("/v1/queries", json=document, headers=await open_session(SUBJECT))
    assert (await answer.json())["code"] == "RATE_LIMITED"
    assert over == [str(asked[0])] == [f"session {SUBJECT.public_key.hex()}"]


async def test_a_page_of_announcements_proves_the_count_and_each_item(api: Any, open_session: Any) -> None:
    headers = await open_session(SUBJECT)
    document = await (await api.get("/v1/announcements?from=1&limit=5", headers=headers)).json()
    assert document["count"] == 3
    assert [item["number"] for item in document["items"]] == [1, 2]
    assert document["items"][0]["robot"] == ROBOT.public_key.hex()
    assert [bytes.fromhex(proof["key"]) for proof in document["proofs"]] == [
        flat("records", b"announcement-count"),
        flat("records", b"announcement/" + u64(1)),
        flat("records", b"announcement/" + u64(2)),
    ]
    document = await (await api.get("/v1/announcements?from=9", headers=headers)).json()
    assert (document["items"], len(document["proofs"])) == ([], 1)


async def test_a_clip_goes_from_its_robot_to_its_owner(api: Any, node: SmallNode, open_session: Any) -> None:
    upload = make_upload()
    check_clip_upload(upload)
    path = f"/v1/clips/{RECORD_ID.hex()}"
    put = f"{path}?owner={upload.owner.hex()}"
    answer = await api.put(put, data=encode(upload), headers=await open_session(ROBOT))
    assert await answer.json() == {"record_id": RECORD_ID.hex(), "status": "staged"}
    assert node.custody.staged[RECORD_ID] == (upload, ROBOT.public_key)
    answer = await api.get(f"{path}?access_id={ACCESS_ID.hex()}", headers=await open_session(OWNER))
    assert answer.content_type == "application/msgpack"
    assert [frame.ciphertext for frame in decode(await answer.read(), ClipDownload).frames] == upload.ciphertexts


async def test_only_its_owner_fetches_a_clip_and_only_under_a_final_access_transaction(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    await node.custody.stage(make_upload(), ROBOT.public_key)
    path = f"/v1/clips/{RECORD_ID.hex()}?access_id={ACCESS_ID.hex()}"
    answer = await api.get(path, headers=await open_session(OTHER_OWNER))
    assert (answer.status, (await answer.json())["code"]) == (403, "NOT_PERMITTED")
    path = f"/v1/clips/{RECORD_ID.hex()}?access_id={bytes(32).hex()}"
    answer = await api.get(path, headers=await open_session(OWNER))
    assert (answer.status, (await answer.json())["code"]) == (403, "ACCESS_NOT_GRANTED")


async def test_a_clip_of_a_record_that_is_not_on_the_chain_is_not_found(api: Any, open_session: Any) -> None:
    path = f"/v1/clips/{bytes(16).hex()}?access_id={ACCESS_ID.hex()}"
    answer = await api.get(path, headers=await open_session(OWNER))
    assert (answer.status, (await answer.json())["code"]) == (404, "NOT_FOUND")


async def test_an_upload_under_another_records_address_is_refused(api: Any, node: SmallNode, open_session: Any) -> None:
    upload = make_upload()
    for record_id, owner in ((bytes(16), upload.owner), (RECORD_ID, OTHER_OWNER.public_key)):
        path = f"/v1/clips/{record_id.hex()}?owner={owner.hex()}"
        answer = await api.put(path, data=encode(upload), headers=await open_session(ROBOT))
        assert (answer.status, (await answer.json())["code"]) == (400, "UPLOAD_INVALID")
    assert node.custody.staged == {}


@pytest.mark.parametrize("path", [f"/v1/clips/{'00' * 16}?owner={'00' * 33}", f"/v1/backgrounds/{'00' * 32}"])
async def test_an_upload_that_is_refused_by_what_stands_before_its_body_is_not_read(
    api: Any, node: SmallNode, open_session: Any, path: str
) -> None:
    headers = await open_session(ROBOT) | {"Content-Type": "application/octet-stream"}
    answered = asyncio.Event()

    async def body() -> Any:
        yield bytes(1024)
        await answered.wait()

    node.custody.refuses = "UPLOAD_QUOTA_EXCEEDED"
    async with asyncio.timeout(10):  # whoever read the body would wait for the rest of it
        answer = await api.put(path, data=body(), headers=headers)
    answered.set()
    assert (answer.status, (await answer.json())["code"]) == (429, "UPLOAD_QUOTA_EXCEEDED")


async def test_an_empty_frame_is_stored_under_its_hash_only(api: Any, open_session: Any) -> None:
    content = b"png"
    robot, path = await open_session(ROBOT), f"/v1/backgrounds/{sha256(content).hex()}"
    wrong = await api.put(f"/v1/backgrounds/{bytes(32).hex()}", data=content, headers=robot)
    assert (await wrong.json())["code"] == "UPLOAD_HASH_MISMATCH"
    assert (await api.get(path, headers=robot)).status == 404
    assert (await api.put(path, data=content, headers=robot)).status == 200
    assert await (await api.get(path, headers=await open_session(OWNER))).read() == content


async def test_blocks_are_listed_and_shown_with_their_receipts(api: Any, node: SmallNode, open_session: Any) -> None:
    transaction = make_transaction(node)
    await api.post("/v1/transactions", data=body_of(transaction.wire))
    await node.pool.finalize()
    headers = await open_session(SUBJECT)
    page = await (await api.get("/v1/blocks?from_height=0&limit=100", headers=headers)).json()
    assert [(block["height"], block["transaction_count"]) for block in page["blocks"]] == [(0, 0), (1, 1)]
    block = await (await api.get("/v1/blocks/1", headers=headers)).json()
    assert (block["txids"], block["receipts"][0]["code"]) == ([transaction.txid.hex()], "OK")
    assert (await (await api.get("/v1/blocks/2", headers=headers)).json())["code"] == "NOT_FOUND"


@pytest.mark.parametrize(
    "path",
    [
        "/v1/blocks?limit=0",
        "/v1/blocks?limit=101",
        "/v1/blocks?limit=x",
        "/v1/blocks?from_height=-1",
        "/v1/blocks/%2B1",
        "/v1/headers?limit=101",
        "/v1/announcements?limit=201",
        "/v1/events?cursor=1",
        "/v1/events?cursor=a:b",
        "/v1/transactions/00",
        f"/v1/transactions/{'AB' * 32}",
        f"/v1/transactions/{'00' * 32}?wait_ms=30001",
    ],
)
async def test_parameters_outside_their_limits_are_refused(api: Any, open_session: Any, path: str) -> None:
    answer = await api.get(path, headers=await open_session(SUBJECT))
    assert (answer.status, (await answer.json())["code"]) == (400, "REQUEST_INVALID")


def receipt_with_events(txid: bytes, *names: str) -> Receipt:
    events = tuple(ContractEvent(contract="records", name=name, data=encode_value({})) for name in names)
    return Receipt(txid=txid, ok=True, code="OK", message="", line=None, gas_used=1, events=events)


async def read_events(response: Any, count: int) -> list[tuple[str, str]]:
    found = []
    async with asyncio.timeout(5):
        while len(found) < count:
            line = (await response.content.readline()).decode().strip()
            if line.startswith("id: "):
                cursor = line[4:]
            elif line.startswith("data: "):
                found.append((cursor, json.loads(line[6:])["name"]))
    return found


async def test_a_stream_of_events_continues_at_its_cursor_or_begins_with_the_next_block(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    await node.ledger.extend(receipts=(receipt_with_events(bytes(32), "one", "two"),))
    headers = await open_session(SUBJECT)
    async with api.get("/v1/events?cursor=1:0", headers=headers) as response:
        assert response.content_type == "text/event-stream"
        assert await read_events(response, 1) == [("1:1", "two")]
        await node.ledger.extend(receipts=(receipt_with_events(bytes(32), "three"),))
        assert await read_events(response, 1) == [("2:0", "three")]
    await node.ledger.extend(receipts=(receipt_with_events(bytes(32), "old"),))
    async with api.get("/v1/events", headers=await open_session(SUBJECT)) as response:
        await node.ledger.extend(receipts=(receipt_with_events(bytes(32), "new"),))
        assert await read_events(response, 1) == [("4:0", "new")]
