"""An empty frame's life on a real network: refused, approved by an admin, published, listed, withdrawn, and gone."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from clients.robot.backgrounds.background_publishing import FOLDER
from clients.robot.identity.robot_keys import load_identity
from clients.robot.run.run_summary import RunSummary
from clients.robot.run.runner import ReplayOptions, replay_recording
from clients.robot.sources.recordings.bag_source import BagSource
from clients.sdk.chain.empty_frames import PREVIEW_FILE
from clients.sdk.connections import NodeAddress
from clients.wallet.records.picture_files import write_pictures
from clients.wallet.records.viewing import RecordViewer
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from tests.cluster.commands import blockrobot, must
from tests.cluster.killed_robot import PURPOSE, KilledRobot, killed_robot
from tests.cluster.network_under_test import NetworkUnderTest

GONE_MAX_S = 30


async def record(robot: KilledRobot) -> RunSummary:
    options = ReplayOptions(
        robot.robot / "roster.sealed", PURPOSE, 300, robot.robot / "events.jsonl", at_once=True, real_time=False
    )
    source, genesis = BagSource(robot.bag), robot.network.genesis
    return await replay_recording(robot.robot, source, genesis, options, lambda figures, *, last=False: None)


async def is_held(robot: KilledRobot, node: NodeAddress, digest: bytes) -> bool:
    """Tell whether a custodian gives the frame out."""
    try:
        await robot.wallet.network.custody.get_background_of(node, digest, robot.wallet.keys.identity)
    except BlockRobotError as error:
        if error.code != "NOT_FOUND":
            raise
        return False
    return True


async def held_by(robot: KilledRobot, digest: bytes) -> list[bool]:
    """Tell of each custodian whether it gives the frame out."""
    return [await is_held(robot, node, digest) for node in robot.wallet.network.custody.custodians]


async def wait_gone(robot: KilledRobot, digests: list[bytes], piece: bytes) -> None:
    """Wait until no custodian gives any of these out, and no file of a node holds the piece."""
    async with asyncio.timeout(GONE_MAX_S):
        while True:
            held = [any(await held_by(robot, digest)) for digest in digests]
            if not any(held) and not files_with(robot.network, piece):
                return
            await asyncio.sleep(0.1)


def files_with(network: NetworkUnderTest, piece: bytes) -> list[Path]:
    """Return the files below the nodes that hold these bytes."""
    found = (path for path in (network.folder / "nodes").rglob("*") if path.is_file())
    return [path for path in found if piece in path.read_bytes()]


async def test_an_empty_frame_is_published_once_approved_and_deleted_everywhere_once_withdrawn(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    async with killed_robot(network, tmp_path) as robot:
        with pytest.raises(BlockRobotError) as refusal:
            await record(robot)
        folder = robot.robot / FOLDER
        assert refusal.value.code == "EMPTY_FRAME_NOT_APPROVED"
        assert f"blockrobot frames approve {folder}" in refusal.value.detail
        assert (folder / PREVIEW_FILE).exists()
        pictures = [path.read_bytes() for path in sorted(folder.glob("[0-9]*.png"))]
        digests = [sha256(picture) for picture in pictures]
        assert not any(await held_by(robot, digests[0]))

        member = load_identity(robot.robot).identity.public_key.hex()
        code, answer = await blockrobot(network, "frames", "approve", str(folder), "--yes", "--as", "university")
        assert (code, answer["error"]["code"]) == (4, "CALL_REFUSED"), "another organisation's admin"
        await must(network, "frames", "approve", str(folder), "--yes", "--as", "hospital")
        listed = (await must(network, "frames", "list", member))["frames"]
        assert [row["sha256"] for row in listed] == [digest.hex() for digest in digests]
        assert {row["approver"] for row in listed} == {network.approver.public_key.hex()}
        assert (await record(robot)).frames.kept > 0
        custodians = robot.wallet.network.custody.custodians
        assert len(custodians) >= 2
        assert [await held_by(robot, digest) for digest in digests] == [[True] * len(custodians)] * len(digests)
        piece = pictures[0][len(pictures[0]) // 2 :][:64]
        assert files_with(network, piece)

        await must(network, "frames", "withdraw", member, digests[0].hex(), "--as", "hospital")
        await must(network, "frames", "withdraw", member, "--all", "--as", "hospital")
        await wait_gone(robot, digests, piece)
        assert (await must(network, "frames", "list", member))["frames"] == []

        report = next(report for report in await robot.read() if report.records)
        viewing, entry = RecordViewer(robot.wallet), report.records[0]
        view = await viewing.view(entry, await viewing.request_access([entry], PURPOSE))
        written = await write_pictures(viewing, view, tmp_path / "pictures")
        assert len(written) >= 2, "what was recorded on it is still hers to see"
        assert {error.code for error in viewing.missing_rooms.values()} == {"EMPTY_FRAME_WITHDRAWN"}
        with pytest.raises(BlockRobotError, match="EMPTY_FRAME_NOT_APPROVED"):
            await record(robot)
