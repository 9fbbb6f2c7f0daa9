"""Sessions: proven once, short-lived, bound to one node and to the key's standing."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from consensus.chain.session_message import sign_session
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import MemberRow
from consensus.state.records import VisitRow
from node.api.access import challenges, sessions
from tests.state_rows import stored
from tests.unit.node.api.small_network import LEFT, OWNER, REGISTRAR, ROBOT, STRANGER, SUBJECT, SmallNode, flat
from tests.unit.node.api.test_routes import receipt_with_events


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


async def test_a_challenge_works_once_for_its_key_and_chain(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    assert (await answer_challenge(api, node, SUBJECT, challenge)).status == 200
    again = await answer_challenge(api, node, SUBJECT, challenge)
    assert (again.status, (await again.json())["code"]) == (401, "CHALLENGE_INVALID")
    answer = await answer_challenge(api, node, ROBOT, await ask_challenge(api, SUBJECT))
    assert (await answer.json())["code"] == "CHALLENGE_INVALID"
    answer = await answer_challenge(api, node, SUBJECT, await ask_challenge(api, SUBJECT), chain_id=bytes(32))
    assert (await answer.json())["code"] == "SIGNATURE_INVALID"
    answer = await api.post("/v1/session-challenges", json={"public_key": "05" + "11" * 32})
    assert (answer.status, (await answer.json())["code"]) == (400, "KEY_INVALID")


async def test_a_wrong_signature_opens_nothing_and_keeps_the_right_one_from_nothing(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    wrong = await answer_challenge(api, node, SUBJECT, challenge, name="n1")
    assert (await wrong.json())["code"] == "SIGNATURE_INVALID"
    assert (await answer_challenge(api, node, SUBJECT, challenge)).status == 200


@pytest.mark.parametrize("place", range(0, 32, 5))
async def test_a_challenge_with_a_changed_byte_is_none(api: Any, node: SmallNode, place: int) -> None:
    """Not even one whose expiry was moved."""
    challenge = bytearray(await ask_challenge(api, SUBJECT))
    challenge[place] ^= 1
    answer = await answer_challenge(api, node, SUBJECT, bytes(challenge))
    assert (await answer.json())["code"] == "CHALLENGE_INVALID"


async def test_a_challenge_ends_after_a_minute(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    node.clock.time_ms += 60_000
    assert (await (await answer_challenge(api, node, SUBJECT, challenge)).json())["code"] == "CHALLENGE_INVALID"


async def test_a_session_ends_when_it_is_closed_or_its_member_leaves_and_after_ten_minutes(
    api: Any, open_session: Any, node: SmallNode
) -> None:
    headers = await open_session(OWNER)
    assert (await api.delete("/v1/sessions", headers=headers)).status == 204
    assert (await api.get("/v1/finality", headers=headers)).status == 401
    headers = await open_session(SUBJECT)
    node.clock.time_ms += 599_999
    assert (await api.get("/v1/finality", headers=headers)).status == 200
    node.clock.time_ms += 1
    answer = await api.get("/v1/finality", headers=headers)
    assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_EXPIRED")
    headers = await open_session(SUBJECT)
    left = stored(MemberRow, role="subject", status="left")
    await node.ledger.extend(writes={flat("identity", b"member/" + SUBJECT.public_key): left})
    answer = await api.get("/v1/finality", headers=headers)
    assert (answer.status, (await answer.json())["code"]) == (403, "SESSION_REFUSED")


@pytest.mark.parametrize("end", ["closed", "left"])
async def test_a_stream_ends_with_its_session_or_with_its_keys_standing(
    api: Any, open_session: Any, node: SmallNode, end: str
) -> None:
    headers = await open_session(SUBJECT)
    async with api.get("/v1/events", headers=headers) as response, asyncio.timeout(5):
        await node.ledger.extend(receipts=(receipt_with_events(bytes(32), "seen"),))
        while b"seen" not in await response.content.readline():
            pass
        left = stored(MemberRow, role="subject", status="left")
        writes = {flat("identity", b"member/" + SUBJECT.public_key): left} if end == "left" else {}
        if end == "closed":
            assert (await api.delete("/v1/sessions", headers=headers)).status == 204
        await node.ledger.extend(writes=writes, receipts=(receipt_with_events(bytes(32), "unseen"),))
        assert b"unseen" not in await response.content.read()


async def test_the_table_stays_bounded(api: Any, open_session: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "SESSIONS_MAX_COUNT", 1)
    first, second = await open_session(SUBJECT), await open_session(ROBOT)
    assert (await api.get("/v1/finality", headers=first)).status == 401
    assert (await api.get("/v1/finality", headers=second)).status == 200


async def test_a_key_that_opens_too_many_sessions_closes_its_own_only(
    api: Any, open_session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "SESSIONS_OF_KEY_MAX_COUNT", 2)
    others = await open_session(SUBJECT)
    own = [await open_session(ROBOT) for _ in range(3)]
    assert [(await api.get("/v1/finality", headers=one)).status for one in own] == [401, 200, 200]
    assert (await api.get("/v1/finality", headers=others)).status == 200


async def test_a_flood_of_challenges_puts_nobody_out(api: Any, node: SmallNode) -> None:
    challenge = await ask_challenge(api, SUBJECT)
    for _ in range(300):
        await ask_challenge(api, STRANGER)
    assert (await answer_challenge(api, node, SUBJECT, challenge)).status == 200


async def test_a_key_is_slowed_down_alone(api: Any, node: SmallNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(challenges, "USED_OF_KEY_MAX_COUNT", 2)
    for _ in range(2):
        assert (await answer_challenge(api, node, ROBOT, await ask_challenge(api, ROBOT))).status == 200
    refused = await answer_challenge(api, node, ROBOT, await ask_challenge(api, ROBOT))
    assert (refused.status, (await refused.json())["code"]) == (429, "RATE_LIMITED")
    assert (await answer_challenge(api, node, SUBJECT, await ask_challenge(api, SUBJECT))).status == 200
    node.clock.time_ms += 60_000
    assert (await answer_challenge(api, node, ROBOT, await ask_challenge(api, ROBOT))).status == 200


async def test_many_keys_of_one_person_close_no_session_of_another(
    api: Any, node: SmallNode, open_session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """She has a key for each visit, and one session for each: members with two looked like the largest."""
    monkeypatch.setattr(sessions, "SESSIONS_MAX_COUNT", 8)
    visits = [PrivateKey(sha256(b"visit %d" % number)) for number in range(20)]
    opened = stored(VisitRow, robot=ROBOT.public_key)
    await node.ledger.extend(writes={flat("records", b"visit/" + key.public_key): opened for key in visits})
    members = [await open_session(key) for key in (SUBJECT, SUBJECT, ROBOT, ROBOT)]
    own = [await open_session(key) for key in visits]

    async def alive(headers: list[dict[str, str]]) -> list[bool]:
        return [(await api.get("/v1/finality", headers=one)).status == 200 for one in headers]

    assert await alive(members) == [True] * 4
    assert await alive(own) == [False] * 16 + [True] * 4
    robots = [await open_session(ROBOT) for _ in range(4)]
    assert await alive(own[-4:]) == [True] * 4, "a member who has most loses his own"
    assert await alive(members[:2] + robots[-2:]) == [True] * 4
