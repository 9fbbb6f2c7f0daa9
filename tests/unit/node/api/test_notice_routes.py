"""What anybody may read before there is a session, and for whom a node signs receipts of consent."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode_value
from consensus.primitives.trie import Proof
from consensus.rights.notices import encode_notice, notice_digest, read_published
from consensus.state.consent import NOTICE, NOTICE_TEXT
from consensus.state.identity import REGISTRAR as REGISTRAR_ROWS
from network.notices.notice_publishing import demo_notice
from node.api import create_api
from node.custody.coordination.consent_receipts import ConsentReceipts
from tests.unit.node.api.small_network import CUSTODIAN, REGISTRAR, STRANGER, SUBJECT, SmallNode, flat
from tests.unit.node.api.test_routes import proof_of


async def prove(api: Any, keys: list[bytes]) -> Any:
    return await api.post("/v1/notice-proofs", json={"keys": [key.hex() for key in keys]})


async def test_who_has_no_session_reads_a_notice_with_its_proof(api: Any, node: SmallNode) -> None:
    document = encode_notice(demo_notice())
    row = {"version": 1, "hash": notice_digest(document), "height": 1, "time": 2, "document": document}
    await node.ledger.extend(writes={NOTICE_TEXT.key(1, "ward"): encode_value(row)})
    keys = [NOTICE_TEXT.key(1, "ward"), NOTICE.key("ward"), REGISTRAR_ROWS.key(REGISTRAR.public_key)]
    answer = await (await prove(api, keys)).json()
    client, values = LightClient(node.ledger.genesis), []
    for key, proved in zip(keys, answer["proofs"], strict=True):
        value = None if proved["value"] is None else bytes.fromhex(proved["value"])
        proof = decode(bytes.fromhex(proved["proof"]), Proof)
        values.append(client.verify_state(proof_of(answer["finality"]), key, value, proof))
    published = read_published("ward", values[0])
    assert published is not None
    assert published.notice == demo_notice()
    assert values[1:] == [None, "ward"]


@pytest.mark.parametrize(
    "key",
    [
        flat("identity", b"member/" + SUBJECT.public_key),
        flat("identity", b"handle/" + bytes(32)),
        flat("consent", b"of/" + bytes(32)),
        flat("records", b"announcement-count"),
        flat("consent", b"notice"),
        flat("identity", b"org/ward"),
    ],
)
async def test_nothing_of_a_person_is_proved_without_a_session(api: Any, key: bytes) -> None:
    answer = await prove(api, [NOTICE.key("ward"), key])
    assert (answer.status, (await answer.json())["code"]) == (403, "NOT_PERMITTED")


async def test_a_stranger_may_not_ask_for_many_proofs_at_once(api: Any) -> None:
    assert (await prove(api, [NOTICE.key("ward")] * 8)).status == 200
    answer = await prove(api, [NOTICE.key("ward")] * 9)
    assert (answer.status, (await answer.json())["code"]) == (400, "REQUEST_INVALID")


async def test_a_node_without_custodian_signs_no_receipt(api: Any, open_session: Any) -> None:
    answer = await api.post("/v1/consent-receipts", json={"txid": "00" * 32}, headers=await open_session(SUBJECT))
    assert (answer.status, (await answer.json())["code"]) == (404, "CONSENT_RECEIPT_ELSEWHERE")


async def test_a_custodian_signs_for_nothing_that_is_not_final(node: SmallNode, open_session: Any, api: Any) -> None:
    headers = await open_session(SUBJECT)
    services = replace(node.services, receipts=ConsentReceipts(CUSTODIAN))
    async with TestClient(TestServer(create_api(services))) as other:
        refused = await other.post("/v1/consent-receipts", json={"txid": "00" * 32}, headers=headers)
        assert (await refused.json())["code"] in {"SESSION_EXPIRED", "SESSION_REQUIRED"}, "a session is one node's"
        wrong = await other.post("/v1/consent-receipts", json={"txid": "00" * 32})
        assert (await wrong.json())["code"] == "SESSION_REQUIRED"
    issuer = ConsentReceipts(CUSTODIAN)
    with node.services.ledger.snapshot() as snapshot:
        for caller, code in ((SUBJECT, "NOT_FOUND"), (STRANGER, "CONSENT_RECEIPT_ELSEWHERE")):
            with pytest.raises(BlockRobotError, match=f"^{code}:"):
                issuer.issue(snapshot, bytes(32), caller.public_key)
