"""Two of four custodians keep each clip: half the bytes at each; one is lost for good, the others take over its share."""

from __future__ import annotations

import asyncio
import time

from clients.sdk.network_client import NetworkClient
from consensus.primitives.keys import PrivateKey
from consensus.records.placement import Placement
from network.bench.custody.custody_clips import ClipRobot, SealedClip
from network.bench.fresh_network import FreshNetwork
from network.cluster import Cluster
from network.custody.custody_requests import ask_status
from node.custody.coordination.custody_answers import ScrubAnswer
from tests.cluster.test_custody_upkeep import _work

CUSTODIANS_COUNT, COPIES_COUNT, CLIPS_COUNT = 4, 2, 24
FRAMES_COUNT, FRAME_BYTES = 3, 6_000
SETTLE_MAX_S = 90.0


async def decide(network: FreshNetwork, client: NetworkClient, contract: str, *proposal: object) -> None:
    """Propose it as one organisation, and let so many others approve it that it takes effect."""
    place = network.cluster.folder / "organisations"
    admins = [PrivateKey((place / org.name / "admin.key").read_bytes()) for org in network.genesis.organisations]
    proposed = await client.call(admins[0], contract, "propose", list(proposal))
    for admin in admins[1 : len(admins) // 2 + 1]:
        await client.call(admin, contract, "approve", [proposed.txid])


async def settled(cluster: Cluster, names: list[str], expected: dict[str, int]) -> None:
    """Wait until each of these serves, follows, lacks nothing, and holds so many clips."""
    deadline = time.monotonic() + SETTLE_MAX_S
    while True:
        rows = [await ask_status(cluster.config(name)) for name in names]
        found = {row.name: row.clips_held for row in rows}
        calm = all(row.serving and not row.behind_blocks and not row.clips_missing for row in rows)
        if calm and found == expected:
            return
        assert time.monotonic() < deadline, (found, expected, [row.clips_missing for row in rows])
        await asyncio.sleep(0.2)


def kept(placement: Placement, names: dict[str, bytes], clips: list[SealedClip]) -> dict[str, int]:
    return {name: sum(placement.is_keeper(key, clip.record_id) for clip in clips) for name, key in names.items()}


async def test_a_custodian_lost_for_good_is_taken_out_and_the_others_keep_two_copies_again() -> None:
    async with FreshNetwork(CUSTODIANS_COUNT, custodians=CUSTODIANS_COUNT) as network:
        cluster, client = network.cluster, network.open_client()
        (enrolled,) = await network.enrol_robots(1)
        await decide(network, client, "settings", "custody_copies", COPIES_COUNT)
        keys = {node.name: node.custodian_key for node in network.genesis.custodians}
        robot = ClipRobot(enrolled.key, network.open_client())
        owner = await robot.open_visit()
        clips = [await robot.record(owner, FRAMES_COUNT, FRAME_BYTES) for _ in range(CLIPS_COUNT)]
        four = Placement.even(keys.values(), COPIES_COUNT)
        shares = kept(four, keys, clips)
        assert sum(shares.values()) == COPIES_COUNT * CLIPS_COUNT
        await settled(cluster, list(keys), shares)

        erased, clips = clips[0], clips[1:]
        await robot.wait_erased(owner, await robot.request_erasure(owner, [erased.record_id]))
        lost = max(keys, key=lambda name: kept(four, keys, clips)[name])
        await asyncio.to_thread(cluster.kill, lost)
        last = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, _to_others(robot, lost))
        await decide(network, client, "membership", "remove_node", {"name": lost})
        left = {name: key for name, key in keys.items() if name != lost}
        three = Placement.even(left.values(), COPIES_COUNT)
        expected = _union(four, three, left, clips, last)
        await settled(cluster, list(left), expected)

        gone, clips = clips[0], clips[1:]
        await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
        await settled(cluster, list(left), _union(four, three, left, clips, last))
        for name in left:
            report = await _work(cluster, name, ScrubAnswer)
            assert report.ok, report


def _to_others(robot: ClipRobot, lost: str):
    """As a robot does: those that are there take it, whoever is to keep it."""

    async def send(upload) -> None:
        for node in robot.client.custody.keepers_first(upload.record_id):
            if node.name != lost:
                await robot.client.custody.upload_clip(node, upload, robot._key)

    return send


def _union(
    before: Placement, after: Placement, left: dict[str, bytes], clips: list[SealedClip], last: SealedClip
) -> dict[str, int]:
    """What each keeps now and what it kept before; `last` everybody took."""
    return {
        name: 1 + sum(before.is_keeper(key, clip.record_id) or after.is_keeper(key, clip.record_id) for clip in clips)
        for name, key in left.items()
    }
