"""A visit that was transferred obeys its new owner key at the interface, and the former key nowhere, from the block on."""

from __future__ import annotations

from typing import Any

from consensus.primitives.encoding import encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from tests.unit.node.api.small_network import ACCESS_ID, OWNER, RECORD_ID, ROBOT, SUBJECT, SmallNode, flat, make_upload

NEW_OWNER = PrivateKey(sha256(b"new owner"))
ANNOUNCED = [NEW_OWNER.public_key, SUBJECT.public_key, 7, 300_000, ROBOT.public_key, OWNER.public_key]


async def transfer(node: SmallNode) -> None:
    """Finalize a block in which the visit gets its new key."""
    values = {
        flat("records", b"current/" + OWNER.public_key): {"owner": NEW_OWNER.public_key, "transfers": 1},
        flat("records", b"root/" + NEW_OWNER.public_key): OWNER.public_key,
        flat("records", b"announcement/" + u64(3)): ANNOUNCED,
        flat("records", b"announcement-count"): 4,
    }
    await node.ledger.extend(writes={key: encode_value(value) for key, value in values.items()})


async def test_the_former_keys_session_ends_and_the_new_key_fetches(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    await node.custody.stage(make_upload(), ROBOT.public_key)
    path = f"/v1/clips/{RECORD_ID.hex()}?access_id={ACCESS_ID.hex()}"
    former = await open_session(OWNER)
    assert (await api.get(path, headers=former)).status == 200
    await transfer(node)
    answer = await api.get(path, headers=former)
    assert (answer.status, (await answer.json())["code"]) == (403, "SESSION_REFUSED")
    assert (await api.get(path, headers=await open_session(NEW_OWNER))).status == 200


async def test_the_new_key_is_announced_with_the_visits_first_key(api: Any, node: SmallNode, open_session: Any) -> None:
    await transfer(node)
    answer = await (await api.get("/v1/announcements?from=2&limit=5", headers=await open_session(SUBJECT))).json()
    opened, transferred = answer["items"]
    assert (opened["root"], transferred["root"]) == (None, OWNER.public_key.hex())
    assert transferred["owner"] == NEW_OWNER.public_key.hex()
