"""The robot's uploads: a record is made only once as many custodians as required have taken the clip."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import pytest
from structlog.testing import capture_logs

from clients.robot.delivery.robot_network import COPIES_DEFAULT_COUNT, RobotNetwork
from consensus.errors import BlockRobotError

UPLOAD: Any = SimpleNamespace(record_id=bytes(16))
STORE_DOWN, UNREACHABLE = BlockRobotError("STORE_UNAVAILABLE"), BlockRobotError("NODE_UNREACHABLE")


class Node(int):
    """A custodian, by its number."""

    @property
    def name(self) -> str:
        return f"node-{int(self)}"


class Custodians:
    """Custodians that take an upload, or refuse it as the test says."""

    def __init__(self, *answers: Exception | None) -> None:
        self.answers = dict(enumerate(answers))
        self.custodians = tuple(map(Node, self.answers))
        self.keepers_count = len(answers)
        self.taken: list[int] = []

    def rank(self, _record_id: bytes) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return self.custodians[: self.keepers_count], self.custodians[self.keepers_count :]

    async def upload_clip(self, node: int, _upload: object, _key: object) -> None:
        answer = self.answers[node]
        if answer is not None:
            raise answer
        self.taken.append(node)


def _robot(custodians: Custodians, copies: int = COPIES_DEFAULT_COUNT) -> RobotNetwork:
    async def find_nodes(_key: object) -> None:
        """Nobody new."""

    client: Any = SimpleNamespace(custody=custodians, find_nodes=find_nodes)
    identity: Any = SimpleNamespace(identity="key")
    return RobotNetwork(client, identity, copies=copies)


@pytest.mark.parametrize(
    "answers",
    [(None,), (None, None), (None, None, None), (None, STORE_DOWN, None), (UNREACHABLE, None, None, STORE_DOWN)],
)
async def test_two_custodians_are_enough_or_the_one_that_there_is(answers: tuple[Exception | None, ...]) -> None:
    custodians = Custodians(*answers)
    await _robot(custodians).upload(UPLOAD)
    assert len(custodians.taken) == answers.count(None) >= min(COPIES_DEFAULT_COUNT, len(answers))


@pytest.mark.parametrize("answers", [(STORE_DOWN,), (None, STORE_DOWN), (UNREACHABLE, None, UNREACHABLE)])
async def test_fewer_are_not_and_what_was_refused_can_be_tried_again(answers: tuple[Exception | None, ...]) -> None:
    """Delivery asks the error whether to try again; the clip stays in the spool until enough have it."""
    with pytest.raises(BlockRobotError) as refusal:
        await _robot(Custodians(*answers)).upload(UPLOAD)
    assert refusal.value.entry.retryable


async def test_a_custodian_that_is_away_is_named_once_and_once_it_is_back() -> None:
    custodians = Custodians(None, STORE_DOWN, None, BlockRobotError("VISIT_NOT_OPEN"))
    robot = _robot(custodians)
    with capture_logs() as told:
        for answer in (STORE_DOWN, STORE_DOWN, UNREACHABLE, UNREACHABLE, None, None):
            custodians.answers[1] = answer
            await robot.upload(UPLOAD)
    away = [(line["event"], line["custodian"], line.get("code")) for line in told]
    assert away == [
        ("custodian_takes_no_uploads", "node-1", "STORE_UNAVAILABLE"),
        ("custodian_takes_no_uploads", "node-1", "NODE_UNREACHABLE"),
        ("custodian_takes_uploads_again", "node-1", None),
    ]


async def test_refusals_are_counted_by_code_and_a_fault_of_the_robots_own_is_none() -> None:
    full = BlockRobotError("UPLOAD_QUOTA_EXCEEDED")
    robot = _robot(Custodians(None, full, None, STORE_DOWN))
    for _ in range(2):
        await robot.upload(UPLOAD)
    assert robot.refused_uploads == {"UPLOAD_QUOTA_EXCEEDED": 2, "STORE_UNAVAILABLE": 2}
    with pytest.raises(ZeroDivisionError):
        await _robot(Custodians(None, None, ZeroDivisionError())).upload(UPLOAD)


@pytest.mark.parametrize(
    ("copies", "answers", "is_enough"),
    [
        (1, (None, STORE_DOWN), True),
        (1, (STORE_DOWN, UNREACHABLE, None), True),
        (1, (STORE_DOWN, UNREACHABLE), False),
        (2, (None, UNREACHABLE, None), True),
        (3, (None, UNREACHABLE, None), False),
        (3, (None, None, None), True),
        (3, (None, None), True),
        (5, (None, None, None, None, None, STORE_DOWN), True),
    ],
)
async def test_how_many_custodians_must_have_a_clip_is_a_setting(
    copies: int, answers: tuple[Exception | None, ...], is_enough: bool
) -> None:
    custodians = Custodians(*answers)
    expected = contextlib.nullcontext() if is_enough else pytest.raises(BlockRobotError)
    with expected:
        await _robot(custodians, copies).upload(UPLOAD)
    assert len(custodians.taken) == answers.count(None), "all that take it are given it"


@pytest.mark.parametrize(
    ("answers", "taken"),
    [
        ((None, None, None, None), [0, 1]),
        ((None, UNREACHABLE, None, None), [0, 2]),
        ((UNREACHABLE, STORE_DOWN, None, None), [2, 3]),
        ((UNREACHABLE, None, STORE_DOWN, None), [1, 3]),
    ],
)
async def test_keepers_are_given_a_clip_and_others_only_in_their_stead(
    answers: tuple[Exception | None, ...], taken: list[int]
) -> None:
    custodians = Custodians(*answers)
    custodians.keepers_count = 2
    await _robot(custodians).upload(UPLOAD)
    assert custodians.taken == taken


async def test_a_robot_waits_for_no_more_than_keep_it_and_for_no_fewer() -> None:
    custodians = Custodians(None, None, None)
    custodians.keepers_count = 2
    await _robot(custodians, 3).upload(UPLOAD)
    assert custodians.taken == [0, 1]
    custodians = Custodians(None, STORE_DOWN, STORE_DOWN)
    custodians.keepers_count = 2
    with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE"):
        await _robot(custodians).upload(UPLOAD)
