"""What a robot brings to a custodian is kept only if it is what the record says; what it is not, nobody gets."""

from __future__ import annotations

import asyncio
import io
import secrets

import msgspec
import pytest

from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import MSGPACK, Intruder, nothing_changes
from tests.security.ward import Ward
from tests.unit.consensus.records.test_png import picture

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

CONFIRM_TIMEOUT_S = 60.0


async def _put(intruder: Intruder, code: str, path: str, content: bytes, token: dict[str, str], **headers: str) -> None:
    body = io.BytesIO(content)
    await intruder.refused(code, "PUT", path, data=body, headers=token | {"Content-Type": MSGPACK} | headers)


async def test_an_empty_frame_must_have_the_hash_that_names_it(network: NetworkUnderTest, intruder: Intruder) -> None:
    ward = Ward(intruder)
    await ward.enrol(ward.robot, "robot")
    token = await intruder.session(ward.robot.identity)
    content, kind = b"an empty corridor", {"Content-Type": "application/octet-stream"}
    path = "/v1/backgrounds/" + sha256(content).hex()
    await ward.approve(network.approver, content)
    async with nothing_changes(network):
        for other in (b"", content + b"\x00", b"another corridor"):
            await _put(intruder, "UPLOAD_HASH_MISMATCH", path, other, token, **kind)
        await _put(intruder, "BACKGROUND_NOT_A_PICTURE", path, content, token, **kind)
        await intruder.refused("NOT_FOUND", "GET", path, headers=token)


async def test_a_picture_is_taken_of_the_robot_for_which_it_is_approved_and_of_no_other(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    """A robot's key alone puts nothing into the clear: neither what nobody looked at nor what another may publish."""
    mine, theirs = Ward(intruder), Ward(intruder)
    await mine.enrol(mine.robot, "robot")
    await theirs.enrol(theirs.robot, "robot")
    content, kind = picture(2, 2, b"\x00\x00\x01\x00\x02" * 2), {"Content-Type": "application/octet-stream"}
    path, refused = f"/v1/backgrounds/{sha256(content).hex()}", "EMPTY_FRAME_NOT_APPROVED"
    tokens = [await intruder.session(ward.robot.identity) for ward in (mine, theirs)]
    await _put(intruder, refused, path, content, tokens[0], **kind)
    await mine.approve(network.approver, content)
    await _put(intruder, refused, path, content, tokens[1], **kind)
    assert (await intruder.ask("PUT", path, data=content, headers=tokens[0] | kind))[0] == 200
    robot, digest = mine.robot.identity.public_key, sha256(content)
    await mine.must(network.approver, "records", "withdraw_empty_frames", robot, [digest])
    await _put(intruder, refused, path, content, tokens[0], **kind)
    await intruder.refused("NOT_FOUND", "GET", path, headers=tokens[0])


async def test_uploads_of_another_form_are_refused(network: NetworkUnderTest, intruder: Intruder) -> None:
    ward = Ward(intruder)
    await ward.open()
    token = await intruder.session(ward.robot.identity)
    good = ward.clip().upload
    path = f"/v1/clips/{good.record_id.hex()}?owner={good.owner.hex()}"
    wrong = [
        {"ciphertexts": good.ciphertexts[:1]},
        {"ciphertexts": [], "sealed_keys": [], "commitment_leaves": []},
        {"ciphertexts": [b"", b""]},
        {"sealed_keys": [b"\x00", b"\x00"]},
        {"commitment_leaves": [b"", b""]},
        {"txid": b""},
        {"valid_until_ms": -1},
        {"valid_until_ms": 1 << 60},
        {"record_id": secrets.token_bytes(16)},
        {"record_id": b""},
        {"owner": secrets.token_bytes(33)},
    ]
    async with nothing_changes(network):
        for changes in wrong:
            upload = msgspec.structs.replace(good, **changes)
            await _put(intruder, "UPLOAD_INVALID", path, encode(upload), token)
        for content in (b"", b"\x93", encode(good)[:-1], b"\x91" * 50_000):
            await _put(intruder, "ENCODING_INVALID", path, content, token)
        await _put(
            intruder,
            "ENCODING_NOT_CANONICAL",
            path,
            b"\xdc\x00" + bytes([encode(good)[0] & 15]) + encode(good)[1:],
            token,
        )
        await _put(
            intruder, "TRANSACTION_EXPIRED", path, encode(msgspec.structs.replace(good, valid_until_ms=1)), token
        )


async def test_a_second_clip_under_the_same_name_does_not_replace_the_first(intruder: Intruder) -> None:
    ward = Ward(intruder)
    await ward.open()
    token = await intruder.session(ward.robot.identity)
    first = ward.clip()
    assert (await ward.upload(first.upload, intruder.node, token))[0] == 200
    assert (await ward.upload(first.upload, intruder.node, token))[0] == 200
    second = ward.resealed(first)
    path = f"/v1/clips/{first.upload.record_id.hex()}?owner={first.upload.owner.hex()}"
    await _put(intruder, "UPLOAD_CONFLICT", path, encode(second.upload), token)


async def test_a_clip_that_is_not_what_its_record_says_is_given_to_nobody(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    """The robot uploads one clip and records the roots of another: the custodian never confirms it."""
    ward = Ward(intruder)
    await ward.open()
    token = await intruder.session(ward.robot.identity)
    recorded = ward.clip()
    record_id = recorded.upload.record_id
    uploaded = ward.resealed(recorded)
    custodians = [node.name for node in intruder.genesis.nodes if node.custodian_key]
    for name in custodians:
        robots = token if name == intruder.node else await intruder.session(ward.robot.identity, name)
        assert (await ward.upload(uploaded.upload, name, robots))[0] == 200
    assert (await intruder.final(ward.record_call(recorded)))["ok"]
    access = await ward.must(ward.owner, "access", "request", [record_id], "own-access")
    owner = await intruder.session(ward.owner)
    path = f"/v1/clips/{record_id.hex()}?access_id={access.txid.hex()}"
    status, _, body = await intruder.ask("GET", path, headers=owner)
    assert status != 200
    assert msgspec.json.decode(body)["code"] in {"CLIP_NOT_CONFIRMED", "NOT_FOUND", "ACCESS_NOT_GRANTED"}
    late = ward.resealed(recorded)
    status, body = await ward.upload(late.upload, intruder.node, token)
    assert (status, msgspec.json.decode(body)["code"]) in {(400, "UPLOAD_HASH_MISMATCH"), (409, "UPLOAD_CONFLICT")}


async def test_only_the_owner_fetches_a_clip_and_only_under_her_own_access(intruder: Intruder) -> None:
    ward, other = Ward(intruder), Ward(intruder)
    await ward.open()
    await other.open()
    clip = ward.clip()
    for name in (node.name for node in intruder.genesis.nodes if node.custodian_key):
        token = await intruder.session(ward.robot.identity, name)
        assert (await ward.upload(clip.upload, name, token))[0] == 200
    assert (await intruder.final(ward.record_call(clip)))["ok"]
    record_id = clip.upload.record_id
    path = f"/v1/clips/{record_id.hex()}?access_id="
    owner, others = await intruder.session(ward.owner), await intruder.session(other.owner)
    refused = await intruder.final(intruder.call(other.owner, "access", "request", [record_id], "own-access"))
    assert not refused["ok"]
    access = await ward.must(ward.owner, "access", "request", [record_id], "own-access")
    deadline = asyncio.get_running_loop().time() + CONFIRM_TIMEOUT_S
    while (answer := await intruder.ask("GET", path + access.txid.hex(), headers=owner))[0] != 200:
        assert asyncio.get_running_loop().time() < deadline, answer
        await asyncio.sleep(0.05)
    await intruder.refused("ACCESS_NOT_GRANTED", "GET", path + "00" * 32, headers=owner)
    await intruder.refused("NOT_PERMITTED", "GET", path + access.txid.hex(), headers=others)
    member = await intruder.session(ward.patient.identity)
    await intruder.refused("NOT_PERMITTED", "GET", path + access.txid.hex(), headers=member)
    others_access = await other.must(other.owner, "access", "request", [], "own-access")
    await intruder.refused("ACCESS_NOT_GRANTED", "GET", path + others_access.txid.hex(), headers=owner)


async def test_a_node_without_a_custodian_says_where_to_go(network: NetworkUnderTest, intruder: Intruder) -> None:
    ward = Ward(intruder)
    await ward.enrol(ward.robot, "robot")
    node = next(node.name for node in intruder.genesis.nodes if not node.custodian_key)
    token = await intruder.session(ward.robot.identity, node)
    upload = ward.clip().upload
    status, body = await ward.upload(upload, node, token)
    assert (status, msgspec.json.decode(body)["code"]) == (404, "CUSTODY_ELSEWHERE")
