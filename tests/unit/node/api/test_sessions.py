"""Sessions: proven once, short-lived, bound to one node and to the key's standing."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.encoding import encode_value
from consensus.primitives.keys import PrivateKey
from consensus.session import sign_session
from node.api import sessions
from tests.unit.node.api.small_network import (
    LEFT,
    OWNER,
    REGISTRAR,
    ROBOT,
    STRANGER,
    SUBJECT,
    SmallNode,
    flat,
)


async def ask_challenge(api: Any, key: PrivateKey) -> bytes:
    answer = await api.post("/v1/session-challenges", json={"public_key": key.public_key.hex()})
    return bytes.fromhex((await answer.json())["challenge"])


async def answer_challenge(
    api: Any, node: SmallNode, key: PrivateKey, challenge: bytes, *, name: str = "n0", chain_id: bytes | None = None
) -> Any:
    signature = sign_session(key, chain_id or node.ledger.genesis.chain_id, name, challenge)
    document = {"public_key": key.public_key.hex(), "challenge": challenge.hex(), "signature": signature.hex()}
    return await api.post("/v1/sessions", json=document)


@pytest.mark.parametrize(
    ("key", "kind"), [(SUBJECT, "member"), (REGISTRAR, "member"), (ROBOT, "member"), (OWNER, "owner")]
)
async def test_a_key_with_standing_gets_a_session_of_its_kind(
    api: Any, node: SmallNode, key: PrivateKey, kind: str
) -> None:
    answer = await answer_challenge(api, node, key, await ask_challenge(api, key))
    document = await answer.json()
    assert document["kind"] == kind
    assert len(document["token"]) == 64
    assert document["expires_at_ms"] == node.clock.time_ms + 600_000


@pytest.mark.parametrize("key", [STRANGER, LEFT])
async def test_a_key_without_standing_gets_none(api: Any, node: SmallNode, key: PrivateKey) -> None:
    answer = await answer_challenge(api, node, key, await ask_challenge(api, key))
    assert (answer.status, (await answer.json())["code"]) == (403, "SESSION_REFUSED")


async def test_a_challenge_works_once(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    assert (await answer_challenge(api, node, SUBJECT, challenge)).status == 200
    again = await answer_challenge(api, node, SUBJECT, challenge)
    assert (again.status, (await again.json())["code"]) == (401, "CHALLENGE_INVALID")


async def test_a_challenge_is_used_up_even_by_a_wrong_signature(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    wrong = await answer_challenge(api, node, SUBJECT, challenge, name="n1")
    assert (await wrong.json())["code"] == "SIGNATURE_INVALID"
    right = await answer_challenge(api, node, SUBJECT, challenge)
    assert (await right.json())["code"] == "CHALLENGE_INVALID"


async def test_a_challenge_of_one_key_is_none_for_another(api: Any, node: SmallNode) -> None:
    answer = await answer_challenge(api, node, ROBOT, await ask_challenge(api, SUBJECT))
    assert (await answer.json())["code"] == "CHALLENGE_INVALID"


async def test_a_challenge_ends_after_a_minute(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    node.clock.time_ms += 60_000
    assert (await (await answer_challenge(api, node, SUBJECT, challenge)).json())["code"] == "CHALLENGE_INVALID"


async def test_a_signature_for_another_chain_is_refused(api: Any, node: SmallNode) -> None:
    answer = await answer_challenge(api, node, SUBJECT, await ask_challenge(api, SUBJECT), chain_id=bytes(32))
    assert (await answer.json())["code"] == "SIGNATURE_INVALID"


async def test_a_session_ends_after_ten_minutes(api: Any, node: SmallNode, open_session: Any) -> None:
    headers = await open_session(SUBJECT)
    node.clock.time_ms += 599_999
    assert (await api.get("/v1/finality", headers=headers)).status == 200
    node.clock.time_ms += 1
    answer = await api.get("/v1/finality", headers=headers)
    assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_EXPIRED")


async def test_a_session_ends_when_its_member_leaves(api: Any, node: SmallNode, open_session: Any) -> None:
    headers = await open_session(SUBJECT)
    left = encode_value({"role": "subject", "status": "left"})
    await node.ledger.extend(writes={flat("identity", b"member/" + SUBJECT.public_key): left})
    answer = await api.get("/v1/finality", headers=headers)
    assert (answer.status, (await answer.json())["code"]) == (403, "SESSION_REFUSED")


async def test_a_closed_session_is_over(api: Any, open_session: Any) -> None:
    headers = await open_session(OWNER)
    assert (await api.delete("/v1/sessions", headers=headers)).status == 204
    assert (await api.get("/v1/finality", headers=headers)).status == 401


async def test_the_tables_stay_bounded(
    api: Any, node: SmallNode, open_session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "SESSIONS_MAX_COUNT", 1)
    monkeypatch.setattr(sessions, "CHALLENGES_MAX_COUNT", 2)
    first_challenge = await ask_challenge(api, SUBJECT)
    first, second = await open_session(SUBJECT), await open_session(ROBOT)
    assert (await api.get("/v1/finality", headers=first)).status == 401
    assert (await api.get("/v1/finality", headers=second)).status == 200
    await ask_challenge(api, ROBOT)
    await ask_challenge(api, ROBOT)
    answer = await answer_challenge(api, node, SUBJECT, first_challenge)
    assert (await answer.json())["code"] == "CHALLENGE_INVALID"


async def test_a_public_key_that_is_no_point_gets_no_challenge(api: Any) -> None:
    answer = await api.post("/v1/session-challenges", json={"public_key": "05" + "11" * 32})
    assert (answer.status, (await answer.json())["code"]) == (400, "KEY_INVALID")
