"""Empty frames become public once they are approved; until then they lie where a person can look at them."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from clients.robot.backgrounds.background_publishing import FOLDER, publish_frames
from clients.robot.cli.robot_choice import RobotPlace
from clients.robot.hiding.background import EmptyFrame, empty_bank
from clients.sdk.chain.empty_frames import PREVIEW_FILE, ROBOT_FILE
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.png import check_depth_png

MEMBER = b"\x02" * 33
ADMIN = PrivateKey(sha256(b"admin"))


class Network:
    """A chain that knows approvals, and custodians."""

    def __init__(self) -> None:
        self.approved: set[bytes] = set()
        self.published: list[EmptyFrame] = []

    async def approve_empty_frames(self, frames: tuple[EmptyFrame, ...], approver: PrivateKey) -> None:
        assert approver == ADMIN
        self.approved |= {frame.background_id for frame in frames}

    async def find_unapproved(self, frames: tuple[EmptyFrame, ...]) -> list[EmptyFrame]:
        return [frame for frame in frames if frame.background_id not in self.approved]

    async def publish_empty_frames(self, frames: tuple[EmptyFrame, ...]) -> None:
        self.published += frames


def bank(count: int = 3) -> tuple[EmptyFrame, ...]:
    return tuple(empty_bank([np.full((60, 80), 1_000 + number, dtype=np.uint16) for number in range(count)]))


async def refusal_of(network: Network, frames: tuple[EmptyFrame, ...], folder: Path) -> BlockRobotError:
    with pytest.raises(BlockRobotError) as refused:
        await publish_frames(network, frames, folder, MEMBER, None)
    assert refused.value.code == "EMPTY_FRAME_NOT_APPROVED"
    return refused.value


async def test_what_is_not_approved_is_left_for_a_person_to_look_at_with_the_next_command(tmp_path: Path) -> None:
    network, frames, folder = Network(), bank(), tmp_path / "a robot"
    network.approved = {frames[0].background_id}
    refused = await refusal_of(network, frames, folder)
    place = folder / FOLDER
    assert refused.detail.endswith(f"blockrobot frames approve {shlex.quote(str(place))} --as ORG")
    assert refused.detail.startswith("2 of the 3")
    assert [path.read_bytes() for path in sorted(place.glob("0*.png"))] == [frame.png for frame in frames[1:]]
    assert (place / ROBOT_FILE).read_text().strip() == MEMBER.hex()
    assert (place / PREVIEW_FILE).read_bytes()[:4] == b"\x89PNG"
    assert network.published == []


async def test_frames_of_an_earlier_run_are_not_left_among_those_to_approve(tmp_path: Path) -> None:
    network = Network()
    await refusal_of(network, bank(5), tmp_path)
    (tmp_path / FOLDER / "ward.png").write_bytes(b"a nurse's")
    await refusal_of(network, bank(2), tmp_path)
    assert (tmp_path / FOLDER / "ward.png").read_bytes() == b"a nurse's"
    files = list((tmp_path / FOLDER).glob("0*.png"))
    assert len(files) == 2
    for path in files:
        check_depth_png(path.read_bytes())


@pytest.mark.parametrize("approver", [None, ADMIN])
async def test_what_is_approved_becomes_public(tmp_path: Path, approver: PrivateKey | None) -> None:
    network, frames = Network(), bank()
    if approver is None:
        network.approved = {frame.background_id for frame in frames}
    await publish_frames(network, frames, tmp_path, MEMBER, approver)
    assert tuple(network.published) == frames
    assert not (tmp_path / FOLDER).exists()


def test_the_admins_key_is_looked_for_beside_the_genesis_file(tmp_path: Path) -> None:
    place = RobotPlace(tmp_path / "robot", tmp_path / "genesis.json")
    assert place.get_approver(None) is None
    with pytest.raises(BlockRobotError, match=r"ORGANISATION_KEY_NOT_FOUND: .* frames approve FOLDER --as hospital"):
        place.get_approver("hospital")
    folder = tmp_path / "organisations" / "hospital"
    folder.mkdir(parents=True)
    (folder / "admin.key").write_bytes(ADMIN.secret)
    found = place.get_approver("hospital")
    assert found is not None
    assert found.public_key == ADMIN.public_key
