"""The robot's uploads: a record is made only once as many custodians as required have taken the clip."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from clients.robot.network import ACKNOWLEDGEMENTS_COUNT, RobotNetwork
from consensus.errors import BlockRobotError

UPLOAD: Any = SimpleNamespace(record_id=bytes(16))
STORE_DOWN, UNREACHABLE = BlockRobotError("STORE_UNAVAILABLE"), BlockRobotError("NODE_UNREACHABLE")


class Custodians:
    """Custodians that take an upload, or refuse it as the test says."""

    def __init__(self, *answers: Exception | None) -> None:
        self.answers = dict(enumerate(answers))
        self.custodians = tuple(self.answers)
        self.taken: list[int] = []

    async def upload_clip(self, node: int, _upload: object, _key: object) -> None:
        answer = self.answers[node]
        if answer is not None:
            raise answer
        self.taken.append(node)


def _robot(custodians: Custodians) -> RobotNetwork:
    async def find_nodes(_key: object) -> None:
        """Nobody new."""

    client: Any = SimpleNamespace(custody=custodians, find_nodes=find_nodes)
    identity: Any = SimpleNamespace(identity="key")
    return RobotNetwork(client, identity)


@pytest.mark.parametrize(
    "answers",
    [(None,), (None, None), (None, None, None), (None, STORE_DOWN, None), (UNREACHABLE, None, None, STORE_DOWN)],
)
async def test_two_custodians_are_enough_or_the_one_that_there_is(answers: tuple[Exception | None, ...]) -> None:
    custodians = Custodians(*answers)
    await _robot(custodians).upload(UPLOAD)
    assert len(custodians.taken) == answers.count(None) >= min(ACKNOWLEDGEMENTS_COUNT, len(answers))


@pytest.mark.parametrize("answers", [(STORE_DOWN,), (None, STORE_DOWN), (UNREACHABLE, None, UNREACHABLE)])
async def test_fewer_are_not_and_what_was_refused_can_be_tried_again(answers: tuple[Exception | None, ...]) -> None:
    """Delivery asks the error whether to try again; the clip stays in the spool until enough have it."""
    with pytest.raises(BlockRobotError) as refusal:
        await _robot(Custodians(*answers)).upload(UPLOAD)
    assert refusal.value.entry.retryable


async def test_a_fault_of_the_robots_own_is_not_taken_for_a_refusal() -> None:
    with pytest.raises(ZeroDivisionError):
        await _robot(Custodians(None, None, ZeroDivisionError())).upload(UPLOAD)
