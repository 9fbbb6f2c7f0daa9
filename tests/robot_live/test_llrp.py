"""A robot that asks its tag reader itself: a real emulated reader in a process of its own, over the loopback."""

from __future__ import annotations

import asyncio
import time
from collections import Counter

import pytest

from clients.robot.sensing.sensor_events import Facing
from clients.robot.sources.live.live_feed import CLOSE_MAX_S
from clients.robot.sources.live.llrp import ANSWER_MAX_S, ASK_EVERY_S, LlrpFeed
from clients.robot.sources.live.llrp_readings import GATHER_MS
from clients.robot.sources.messages.topics import LlrpReader, Topics
from consensus.errors import BlockRobotError
from tests.robot_live.listening import Heard, listening
from tests.robot_live.tag_readers import ANN, BEN, TagReaders
from tests.robot_live.ward import free_port

NO_TOPICS = Topics(tags=())
LATE_MAX_MS = 10_000
"""How late a busy machine may hear of a tag; the wrong clocks here are wrong by hours."""


def age_ms(heard: Heard) -> list[int]:
    """How long before it came each reading ended."""
    return [(one.received_at_ms or 0) - one.last_seen_ms for one in heard.sightings]


@pytest.mark.smoke
async def test_readings_are_sightings_with_a_facing_and_without_a_distance(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start()
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: {ANN, BEN} <= {one.uid for one in heard.sightings})
    assert {(one.uid, one.antenna, one.facing) for one in heard.sightings} == {
        (ANN, 1, Facing.FRONT),
        (BEN, 2, Facing.BACK),
    }
    assert {(one.distance_m, one.sigma_m) for one in heard.sightings} == {(None, None)}
    assert all(-70 < one.rssi_dbm < -40 for one in heard.sightings)
    assert heard.refused == []
    assert heard.told_of(reader.address) == []


async def test_a_reader_that_is_killed_and_comes_back_is_told_of_once_and_asked_again(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start()
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: len(heard.sightings) > 3)
        await tag_readers.kill()
        await heard.until(lambda: len(heard.told_of(reader.address)) == 1)
        await asyncio.sleep(2.0)  # long enough for several attempts
        before = len(heard.sightings)
        assert heard.told_of(reader.address) == [f"{reader.address} is gone; it is waited for."]
        await tag_readers.start(reader.port)
        await heard.until(lambda: len(heard.sightings) > before + 3)
    assert heard.told_of(reader.address)[1:] == [f"{reader.address} is there."]
    assert heard.intake.gone[reader.address] == 1


async def test_of_two_readers_one_may_be_gone_and_each_has_its_own_clock(tag_readers: TagReaders) -> None:
    right = await tag_readers.start(tags={ANN: [1]}, clock_off_s=-86_400.0)
    left = await tag_readers.start(tags={BEN: [1]}, clock_off_s=7_200.0)
    async with listening([LlrpFeed([left, right])], NO_TOPICS) as heard:
        await heard.until(lambda: {ANN, BEN} <= {one.uid for one in heard.sightings})
        await tag_readers.kill()
        await heard.until(lambda: len(heard.told_of(left.address)) == 1)
        before = len(heard.sightings)
        await heard.until(lambda: len(heard.sightings) > before + 5)
    assert heard.told_of(right.address) == []
    assert all(0 <= age < LATE_MAX_MS for age in age_ms(heard))


async def test_a_storm_of_ten_thousand_reports_a_second_is_as_few_sightings_as_there_are_tags(
    tag_readers: TagReaders,
) -> None:
    tags = {f"E280116060000205{number:08X}": [1, 2] for number in range(21)}
    reader = await tag_readers.start(tags=tags, storm_per_s=10_000)
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        began = time.monotonic()
        await heard.until(lambda: sum(one.read_count for one in heard.sightings) >= 20_000)
        lasted_s = time.monotonic() - began
    read = Counter((one.uid, one.antenna) for one in heard.sightings)
    assert set(read) == {(uid, antenna) for uid in tags for antenna in (1, 2)}
    assert max(read.values()) <= 1 + (lasted_s + 1) * 1000 / GATHER_MS
    assert heard.intake.missed == {}
    # A machine so busy that the first reports were late takes a few of the next for a wrong clock's, until it knows better.
    assert set(heard.refused) <= {("sighting", "time")}
    assert len(heard.refused) <= 10


@pytest.mark.parametrize("clock_off_s", [-1_700_000_000.0, 86_400.0])
async def test_a_reader_whose_clock_is_wrong_tells_when_tags_were_seen_all_the_same(
    tag_readers: TagReaders, clock_off_s: float
) -> None:
    reader = await tag_readers.start(clock_off_s=clock_off_s)
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: len(heard.sightings) > 10)
    assert all(0 <= age < LATE_MAX_MS for age in age_ms(heard))
    assert heard.refused == []


@pytest.mark.smoke
async def test_tags_whose_epc_makes_no_sense_are_refused_and_the_others_read(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start(tags={ANN: [1], "01": [1], "AB" * 34: [1], "": [1]})
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: len(heard.sightings) > 3 and len(heard.refused) > 10)
    assert {one.uid for one in heard.sightings} == {ANN}
    assert set(heard.refused) == {("sighting", "tag")}


async def test_a_reader_that_sends_nonsense_is_left_and_asked_again(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start(nonsense_after_s=0.5)
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: len(heard.told_of(reader.address)) >= 2)
        before = len(heard.sightings)
        await heard.until(lambda: len(heard.sightings) > before + 3)
    assert heard.told_of(reader.address)[:2] == [
        f"{reader.address} is gone; it is waited for.",
        f"{reader.address} is there.",
    ]


async def test_a_reader_that_hangs_is_noticed_though_nothing_closes_the_connection(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start()
    async with listening([LlrpFeed([reader])], NO_TOPICS) as heard:
        await heard.until(lambda: len(heard.sightings) > 3)
        began = time.monotonic()
        tag_readers.running[-1].send_signal(19)  # SIGSTOP
        await heard.until(lambda: bool(heard.told_of(reader.address)))
        assert time.monotonic() - began < 2 * (ASK_EVERY_S + ANSWER_MAX_S)
        tag_readers.running[-1].send_signal(18)  # SIGCONT
        before = len(heard.sightings)
        await heard.until(lambda: len(heard.sightings) > before + 3)


async def test_leaving_frees_the_reader_for_the_next_and_ends_the_thread_in_time(tag_readers: TagReaders) -> None:
    reader = await tag_readers.start()
    for _ in range(3):
        feed = LlrpFeed([reader])
        async with listening([feed], NO_TOPICS) as heard:
            await heard.until(lambda: len(heard.sightings) > 1)
            began = time.monotonic()
        assert time.monotonic() - began < CLOSE_MAX_S
        feed.close()
        assert feed._thread is not None
        assert not feed._thread.is_alive()


async def test_a_reader_that_is_taken_or_not_there_is_said_at_the_start(tag_readers: TagReaders) -> None:
    reader, nobody = await tag_readers.start(), LlrpReader("127.0.0.1", free_port())
    with pytest.raises(BlockRobotError) as caught:
        async with listening([LlrpFeed([reader, nobody])], NO_TOPICS):
            pass
    assert caught.value.code == "FEED_UNREACHABLE"
    assert caught.value.detail == f"The LLRP reader at {nobody.address} does not answer: Connection refused."
    async with listening([LlrpFeed([reader])], NO_TOPICS):
        with pytest.raises(BlockRobotError) as caught:
            await asyncio.to_thread(LlrpFeed([reader]).open, {}, None)
    assert caught.value.code == "FEED_UNREACHABLE"
    assert "Already_Exists" in caught.value.detail
