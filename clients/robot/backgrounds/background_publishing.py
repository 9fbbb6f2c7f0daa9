"""Publishes empty frames approved on chain; leaves others for a person."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Protocol

from clients.robot.backgrounds.background_banks import NUMBERED_PICTURES
from clients.robot.hiding.background import EmptyFrame
from clients.sdk.chain.empty_frames import PREVIEW_FILE, ROBOT_FILE
from clients.sdk.new_files import require_own_folder, write_private
from clients.sdk.pictures.rendition_picture import draw_preview
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

FOLDER = "empty-frames"


class PublishingNetwork(Protocol):
    """What publishing needs of the network."""

    async def approve_empty_frames(self, frames: tuple[EmptyFrame, ...], approver: PrivateKey) -> None: ...

    async def find_unapproved(self, frames: tuple[EmptyFrame, ...]) -> list[EmptyFrame]: ...

    async def publish_empty_frames(self, frames: tuple[EmptyFrame, ...]) -> None:
        """To the custodians."""


async def publish_frames(
    network: PublishingNetwork, frames: tuple[EmptyFrame, ...], robot: Path, member: bytes, approver: PrivateKey | None
) -> None:
    """Send to custodians. Raises EMPTY_FRAME_NOT_APPROVED, leaving frames in the robot's folder."""
    if approver is not None:
        await network.approve_empty_frames(frames, approver)
    waiting = await network.find_unapproved(frames)
    if waiting:
        place = write_for_approval(robot, member, waiting)
        raise BlockRobotError(
            "EMPTY_FRAME_NOT_APPROVED",
            f"{len(waiting)} of the {len(frames)} empty frames are not approved on the chain. Look at "
            f"{place / PREVIEW_FILE}: if nobody is in it, an admin of the robot's organisation says "
            f"blockrobot frames approve {shlex.quote(str(place))} --as ORG",
        )
    await network.publish_empty_frames(frames)


def write_for_approval(robot: Path, member: bytes, frames: list[EmptyFrame]) -> Path:
    """Return their folder."""
    place = robot / FOLDER
    require_own_folder(place)
    for old in place.glob(NUMBERED_PICTURES):
        old.unlink()
    for number, frame in enumerate(frames):
        write_private(place / f"{number:03d}.png", frame.png)
    write_private(place / PREVIEW_FILE, draw_preview([frame.png for frame in frames]))
    write_private(place / ROBOT_FILE, member.hex() + "\n")
    return place
