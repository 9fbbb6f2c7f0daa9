"""The robot is killed at each step of its pipeline and started again: what was spooled is recorded, once, and no more."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.cluster.killed_robot import killed_robot
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.robot_to_kill import STEPS

LIKELIEST = ("visit-counted-before-sync", "uploaded-to-one", "record-submitted", "receipt-seen")
"""Where a picture would be lost or doubled most easily: stored but not yet counted, at one custodian, on its way, told."""

DESTROYING = ("clip-nameless", "clip-destroyed", "visit-lowered")
LIVES_COUNT = 6
LIVE_S = 12.0


async def test_a_robot_that_is_killed_again_and_again_loses_nothing_that_it_had_spooled(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    """Each life finds what the ones before it left, and is killed one step later than they were."""
    async with killed_robot(network, tmp_path) as robot:
        for step in LIKELIEST:
            await robot.live(step)
        await robot.live()
        await robot.check()
        assert len(robot.diaries.spooled) > len(LIKELIEST)


@pytest.mark.long
@pytest.mark.timeout(1_800)
async def test_a_robot_that_is_killed_at_any_step_of_its_pipeline_goes_on_where_it_was(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    async with killed_robot(network, tmp_path) as robot:
        for step in STEPS:
            if step not in DESTROYING:
                await robot.live(step)
                await robot.live()
                await robot.check()


@pytest.mark.long
@pytest.mark.timeout(600)
async def test_a_no_that_is_said_while_the_robot_is_dead_is_carried_out_by_whichever_life_comes_to_it(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    """What was spooled is destroyed, over further kills; the chain never hears of a visit that was not announced."""
    async with killed_robot(network, tmp_path) as robot:
        await robot.live("spooled")
        await robot.withdraw()
        for step in DESTROYING[:2]:
            await robot.live(step)
        await robot.live()
        await robot.check()
        assert await robot.read() == []

        await robot.consent()
        await robot.live("announced")
        await robot.withdraw()
        await robot.live(DESTROYING[2])
        await robot.live()
        await robot.check()
        (report,) = await robot.read()
        assert (report.closed, report.records, report.missing_count) == (True, (), 0)


@pytest.mark.long
@pytest.mark.timeout(900)
async def test_a_live_robot_that_is_killed_at_any_moment_loses_nothing_that_it_had_spooled(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    """While it still looks, decides, seals and delivers, all at once."""
    moments = random.Random(5)
    async with killed_robot(network, tmp_path) as robot:
        for _ in range(LIVES_COUNT):
            await robot.watch(LIVE_S, killed_after_s=moments.uniform(0.0, 3.0))
        killed_with_count = len(robot.diaries.spooled)
        await robot.watch(LIVE_S)
        await robot.check()
        assert killed_with_count > LIVES_COUNT
