"""A registered robot that floods custodians is refused at its quota, by name, while they go on erasing for everybody."""

from __future__ import annotations

import asyncio
import json
import secrets
from typing import Any

import msgspec
import pytest

from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from network.custody.custody_requests import ask_status
from network.doctor.examination import examine_network
from node.config import READING_TOKEN_FILE_NAME
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import MSGPACK, Intruder
from tests.security.ward import Clip, Ward
from tests.unit.consensus.records.test_png import picture

pytestmark = pytest.mark.asyncio(loop_scope="module")

STAGED_MAX_COUNT = 6
FLOOD_COUNT = 30


async def _decide(network: NetworkUnderTest, intruder: Intruder, name: str, value: int) -> None:
    """Let both organisations decide a setting."""
    keys = [
        PrivateKey((network.folder / "organisations" / organisation / "admin.key").read_bytes())
        for organisation in ("hospital", "university")
    ]
    proposal = intruder.call(keys[0], "settings", "propose", name, value)
    assert (await intruder.final(proposal))["ok"]
    assert (await intruder.final(intruder.call(keys[1], "settings", "approve", proposal.txid)))["ok"]


async def _put(intruder: Intruder, clip: Clip, token: dict[str, str]) -> tuple[int, dict[str, str], dict[str, Any]]:
    path = f"/v1/clips/{clip.upload.record_id.hex()}?owner={clip.upload.owner.hex()}"
    headers = token | {"Content-Type": MSGPACK}
    async with intruder.http.put(intruder.url(path), data=encode(clip.upload), headers=headers) as response:
        return response.status, dict(response.headers), json.loads(await response.text())


async def _metrics(network: NetworkUnderTest, intruder: Intruder) -> list[str]:
    """Return the lines that a custodian's operator's listener shows a monitoring system."""
    config = network.cluster.configs[intruder.node]
    token = (config.data_dir / READING_TOKEN_FILE_NAME).read_text().strip()
    url, shown = f"http://127.0.0.1:{config.operator_port}/metrics", {"Authorization": f"Bearer {token}"}
    async with intruder.http.get(url, headers=shown) as response:
        assert response.status == 200
        return (await response.text()).splitlines()


async def test_a_flood_of_clips_ends_at_the_quota_and_custodians_erase_on(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    flooding, honest = Ward(intruder), Ward(intruder)
    await flooding.open()
    await honest.open()
    await _decide(network, intruder, "robot_staged_max_count", STAGED_MAX_COUNT)
    token, good = await intruder.session(flooding.robot.identity), await intruder.session(honest.robot.identity)
    taken, refusals = 0, []
    for _ in range(FLOOD_COUNT):
        status, headers, answer = await _put(intruder, flooding.clip(), token)
        if status == 200:
            taken += 1
        else:
            refusals.append((status, answer["code"], int(headers["Retry-After"]) > 0))
    assert taken == STAGED_MAX_COUNT
    assert set(refusals) == {(429, "UPLOAD_QUOTA_EXCEEDED", True)}
    clip = honest.clip()
    for name in (node.name for node in intruder.genesis.nodes if node.custodian_key):
        robots = good if name == intruder.node else await intruder.session(honest.robot.identity, name)
        assert (await honest.upload(clip.upload, name, robots))[0] == 200, "another robot's clips are taken"
    assert (await intruder.final(honest.record_call(clip)))["ok"]
    await honest.must(honest.owner, "erasure", "request", [clip.upload.record_id], [])
    for _ in range(200):
        status = await ask_status(network.cluster.configs[intruder.node])
        if status.clips_erased and not status.outbox_ready and not status.waiting_for:
            break
        await asyncio.sleep(0.05)
    else:
        raise AssertionError(status)
    row = next(row for row in status.uploads if row.robot == flooding.robot.identity.public_key.hex())
    assert (row.organisation, row.staged_clips, row.refused) == ("hospital", taken, len(refusals))
    labels = f'{{organisation="hospital",robot="{flooding.robot.identity.public_key.hex()}"}}'
    figures = await _metrics(network, intruder)
    assert f"blockrobot_uploads_staged_clips{labels} {taken}.0" in figures
    assert f"blockrobot_uploads_refused{labels} {len(refusals)}.0" in figures
    assert f'blockrobot_upload_quota_clips{{quota="robot_staged_max_count"}} {STAGED_MAX_COUNT}.0' in figures
    found = await asyncio.to_thread(examine_network, network.folder)
    named = [item for item in found.findings if item.code == "UPLOADS_REFUSED"]
    assert any(flooding.robot.identity.public_key.hex()[:16] in item.detail for item in named)


async def test_clips_of_no_open_visit_of_the_robots_own_are_refused(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    mine, theirs = Ward(intruder), Ward(intruder)
    await mine.open()
    await theirs.open()
    token = await intruder.session(mine.robot.identity)
    strange = [secrets.token_bytes(33), theirs.owner.public_key]
    for owner in strange:
        upload = msgspec.structs.replace(mine.clip().upload, owner=owner)
        status, _, answer = await _put(intruder, Clip(upload, [], []), token)
        assert (status, answer["code"]) == (409, "VISIT_NOT_OPEN")
    await mine.must(mine.robot.identity, "records", "close_visit", mine.owner.public_key, 0)
    status, _, answer = await _put(intruder, mine.clip(), token)
    assert (status, answer["code"]) == (409, "VISIT_NOT_OPEN")


async def test_empty_frames_are_depth_pictures_and_count_for_the_robots_day(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    ward = Ward(intruder)
    await ward.enrol(ward.robot, "robot")
    token = (await intruder.session(ward.robot.identity)) | {"Content-Type": "application/octet-stream"}
    await _decide(network, intruder, "robot_day_max_mib", 1)
    codes = []
    for _ in range(4):
        content = picture(400, 500, b"".join(b"\x00" + secrets.token_bytes(800) for _ in range(500)))
        path = f"/v1/backgrounds/{sha256(content).hex()}"
        await ward.approve(network.approver, content)
        status, _, body = await intruder.ask("PUT", path, data=content, headers=token)
        codes.append("OK" if status == 200 else msgspec.json.decode(body)["code"])
    assert codes == ["OK", "OK", "UPLOAD_QUOTA_EXCEEDED", "UPLOAD_QUOTA_EXCEEDED"]
