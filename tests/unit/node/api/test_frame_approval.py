"""Whether an empty frame may be kept is looked up once more when it is here: the approval may be gone meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.state.records import EMPTY_FRAMES, EmptyFrameRow
from node.custody.coordination.upload_admission import UploadAdmission
from node.ledger.ledger_writer import FinalityFeed
from tests.unit.node.api.small_network import ROBOT, SUBJECT, SmallNode

FRAME, OTHER = sha256(b"an empty room"), sha256(b"another")


async def test_only_a_frame_that_is_approved_for_this_robot_now_is_kept(node: SmallNode) -> None:
    nobody: Any = None
    admission = UploadAdmission(node.services.ledger, FinalityFeed(-1), nobody)
    robot, place = ROBOT.public_key, EMPTY_FRAMES.key(ROBOT.public_key)
    await node.ledger.extend(writes={place: EMPTY_FRAMES.encode([EmptyFrameRow(FRAME, SUBJECT.public_key, 1)])})
    admission.require_approved(FRAME, robot)
    for digest, key in ((OTHER, robot), (FRAME, SUBJECT.public_key)):
        with pytest.raises(BlockRobotError, match="EMPTY_FRAME_NOT_APPROVED"):
            admission.require_approved(digest, key)
    await node.ledger.extend(writes={place: EMPTY_FRAMES.encode([])})
    with pytest.raises(BlockRobotError, match="EMPTY_FRAME_NOT_APPROVED"):
        admission.require_approved(FRAME, robot)
