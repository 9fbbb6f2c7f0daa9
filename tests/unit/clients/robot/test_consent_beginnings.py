"""From when a consent counts at a robot: its block, its period, and that to prolong it is no new beginning."""

from __future__ import annotations

import asyncio

from clients.robot.hiding.withhold_reason import WithholdReason
from tests.unit.clients.robot.test_consents import ANN, STEP_MS, Ward, story
from tests.virtual_time import virtual_now_ms


@story()
async def test_a_consent_begins_with_the_first_block_of_its_height_that_the_robot_sees(ward: Ward) -> None:
    ward.registry.say(ANN, height=ward.registry.height + 40)
    said_ms = virtual_now_ms()
    await ward.consents.refresh()
    assert ward.refusal() is WithholdReason.NO_CONSENT
    await asyncio.sleep(7)
    ward.registry.height += 50
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=said_ms + 3_000) is WithholdReason.OUTSIDE
    assert ward.refusal() is None


async def seen_before_and_at_its_height(ward: Ward) -> None:
    """Read when the newest word is known and does not count yet, and again when it does."""
    ward.registry.idle = True
    await ward.consents.refresh()
    await asyncio.sleep(2)
    ward.registry.idle = False
    await ward.consents.refresh()


@story()
async def test_a_consent_that_is_prolonged_keeps_the_pictures_that_wait(ward: Ward) -> None:
    ward.registry.say(ANN)
    since_ms = ward.registry.time_ms
    await asyncio.sleep(1)
    await ward.consents.refresh()
    taken_ms = virtual_now_ms()
    ward.registry.say(ANN, since_ms=since_ms)
    await seen_before_and_at_its_height(ward)
    assert ward.refusal(taken_at_ms=taken_ms) is None
    assert ward.refusal(taken_at_ms=since_ms - 1) is WithholdReason.OUTSIDE


@story()
async def test_a_prolonged_consent_begins_no_earlier_than_the_one_that_it_prolongs(ward: Ward) -> None:
    ward.registry.say(ANN, height=ward.registry.height + 40)
    since_ms = ward.registry.time_ms
    await ward.consents.refresh()
    await asyncio.sleep(7)
    ward.registry.height += 50
    await ward.consents.refresh()
    began_ms = virtual_now_ms()
    ward.registry.say(ANN, since_ms=since_ms)
    await seen_before_and_at_its_height(ward)
    assert ward.refusal(taken_at_ms=since_ms + 3_000) is WithholdReason.OUTSIDE
    assert ward.refusal(taken_at_ms=began_ms) is None


@story()
async def test_a_consent_that_follows_one_which_is_over_by_then_prolongs_nothing(ward: Ward) -> None:
    end_ms = virtual_now_ms() - virtual_now_ms() % STEP_MS + STEP_MS
    ward.registry.say(ANN, until_ms=end_ms)
    since_ms = ward.registry.time_ms
    ward.registry.say(ANN, since_ms=since_ms, height=ward.registry.height + 40)
    await ward.consents.refresh()
    await asyncio.sleep((end_ms - virtual_now_ms()) / 1000 + 3)
    ward.registry.height += 50
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=end_ms + 1_000) is WithholdReason.OUTSIDE
    assert ward.refusal() is None


@story()
async def test_a_picture_from_before_the_consent_is_refused(ward: Ward) -> None:
    before_ms = virtual_now_ms()
    await asyncio.sleep(1)
    ward.registry.say(ANN)
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=before_ms) is WithholdReason.OUTSIDE


@story()
async def test_a_period_counts_by_when_a_picture_was_taken(ward: Ward) -> None:
    begin = virtual_now_ms() - virtual_now_ms() % STEP_MS + STEP_MS
    ward.registry.say(ANN, from_ms=begin, until_ms=begin + STEP_MS)
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=begin - 1) is WithholdReason.OUTSIDE
    assert ward.refusal(taken_at_ms=begin) is None
    assert ward.refusal(taken_at_ms=begin + STEP_MS - 1) is None
    assert ward.refusal(taken_at_ms=begin + STEP_MS) is WithholdReason.OUTSIDE
