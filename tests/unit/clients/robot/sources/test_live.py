"""A live source over feeds made by hand: what comes is played as it comes, what goes is said, and the end is orderly."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from clients.robot.sensing.message_names import IMAGE_TYPE, SIGHTING_TYPE
from clients.robot.sensing.sensor_events import Frame, RefusedMessage, Sighting, SourceEvent
from clients.robot.sources.live import live_source
from clients.robot.sources.live.live_feed import Listener
from clients.robot.sources.live.live_queue import LiveQueue
from clients.robot.sources.live.live_sampling import Sample, record_empty_frames
from clients.robot.sources.live.live_source import INFO_TYPE, LiveSource
from clients.robot.sources.messages.message_types import Message
from clients.robot.sources.messages.topics import Topics, parse_topics
from clients.robot.sources.recordings.topic_listing import draft_topics, list_topics, next_steps
from clients.robot.sources.source import StoppableClock
from clients.robot.synthetic.bag_messages import MessageCodec
from consensus.errors import BlockRobotError

DEPTH, TAGS, INFO = "/camera/depth/image_raw", "/rfid/sightings", "/camera/depth/camera_info"
CODEC = MessageCodec()
NOW_MS = 1_800_000_000_000


class FeedByHand:
    """A feed whose messages a test delivers, from a thread of its own as middleware does."""

    ros1 = False

    def __init__(self, name: str = "hand", topics: Mapping[str, str] | None = None) -> None:
        self.name = name
        self.advertised = dict({DEPTH: IMAGE_TYPE, TAGS: SIGHTING_TYPE} if topics is None else topics)
        self.wanted: dict[str, str] = {}
        self.listener: Listener | None = None
        self.refusal: BlockRobotError | None = None
        self.closed_count = 0

    def topics(self) -> dict[str, str]:
        return dict(self.advertised)

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.wanted, self.listener = dict(wanted), listener

    def close(self) -> None:
        self.closed_count += 1

    def do(self, what: str, *values: Any, **named: Any) -> None:
        thread = threading.Thread(target=getattr(self.listener, what), args=values, kwargs=named)
        thread.start()
        thread.join()

    def frame(self, number: int, topic: str = DEPTH) -> None:
        data = bytes(CODEC.encode_image(np.full((4, 6), 1000 + number, np.uint16), NOW_MS + number))
        self.do("deliver", Message(topic, IMAGE_TYPE, (NOW_MS + number) * 1_000_000, data))

    def reading(self, number: int) -> None:
        sighting = Sighting(NOW_MS + number, NOW_MS + number, f"E{number}")
        data = bytes(CODEC.encode_sighting(sighting, NOW_MS + number))
        self.do("deliver", Message(TAGS, SIGHTING_TYPE, (NOW_MS + number) * 1_000_000, data))


class Playing:
    """A source that is played beside a test."""

    def __init__(self, source: LiveSource) -> None:
        self.source = source
        self.stop = asyncio.Event()
        self.events: list[SourceEvent] = []
        self.task = asyncio.create_task(self._play())

    async def _play(self) -> None:
        async for event in self.source.play(StoppableClock(self.stop)):
            self.events.append(event)

    async def count(self, count: int) -> list[SourceEvent]:
        async with asyncio.timeout(5):
            while len(self.events) < count:  # noqa: ASYNC110 - events come from threads
                await asyncio.sleep(0)
        return self.events

    async def end(self) -> list[SourceEvent]:
        self.stop.set()
        await asyncio.wait_for(self.task, 5)
        return self.events


async def playing(source: LiveSource) -> Playing:
    made = Playing(source)
    while not source._is_playing:  # noqa: ASYNC110
        await asyncio.sleep(0)
    return made


async def test_frames_and_readings_are_played_as_they_come_numbered_and_with_the_time_of_receipt() -> None:
    feed = FeedByHand()
    with LiveSource([feed], Topics()) as source:
        played = await playing(source)
        for number in range(3):
            feed.frame(number)
            feed.reading(number)
        events = await played.count(6)
        await played.end()
    frames = [event for event in events if isinstance(event, Frame)]
    assert [(frame.sequence, frame.received_at_ms - NOW_MS) for frame in frames] == [(0, 0), (1, 1), (2, 2)]
    assert [int(frame.depth[0, 0]) for frame in frames] == [1000, 1001, 1002]
    assert [event.uid for event in events if isinstance(event, Sighting)] == ["E0", "E1", "E2"]
    intake = source.count_intake()
    assert (intake.heard, intake.missed, intake.unread) == ({DEPTH: 3, TAGS: 3}, {}, {})
    assert feed.closed_count == 1


async def test_what_comes_before_a_run_plays_or_after_it_ended_is_not_taken() -> None:
    feed = FeedByHand()
    with LiveSource([feed], Topics()) as source:
        feed.frame(0)
        played = await playing(source)
        feed.frame(1)
        await played.count(1)
        await played.end()
        feed.frame(2)
    assert [int(event.depth[0, 0]) for event in played.events if isinstance(event, Frame)] == [1001]


async def test_what_the_robot_is_too_slow_for_is_dropped_oldest_first_and_what_waits_at_the_end_is_told() -> None:
    feed = FeedByHand()
    with LiveSource([feed], Topics()) as source:
        source._queue = LiveQueue(max_count=4)
        played = source.play()
        waiting = asyncio.create_task(anext(played))
        while not source._is_playing:  # noqa: ASYNC110
            await asyncio.sleep(0)
        for number in range(7):
            feed.frame(number)
        first = await waiting
        assert isinstance(first, Frame)
        assert int(first.depth[0, 0]) == 1003
        await played.aclose()
    assert source.count_intake().missed == {"frame": 3}
    assert source.count_intake().unread == {"frame": 3}


async def test_messages_that_are_of_another_type_or_of_none_that_is_known_are_refused_one_by_one() -> None:
    feed = FeedByHand()
    topics = parse_topics("[[tags]]\ntopic = '/rfid/sightings'\nepc = 'epc'")
    with LiveSource([feed], topics) as source:
        played = await playing(source)
        feed.do("deliver", Message(DEPTH, "std_msgs/msg/String", 0, b""))
        feed.do("deliver", Message(TAGS, "ward_msgs/msg/Secret", 0, b"\0"))
        feed.do("learn", "ward_msgs/msg/Secret", "%%%")
        feed.do("deliver", Message(TAGS, "ward_msgs/msg/Secret", 0, b"\0"))
        feed.do("learn", "ward_msgs/msg/Secret", "string epc")
        feed.do("deliver", Message(TAGS, "ward_msgs/msg/Secret", 0, b"\0\1\0\0\3\0\0\0E1\0"))
        feed.do("deliver", Message(DEPTH, IMAGE_TYPE, 0, b"rubbish"))
        feed.do("refuse", RefusedMessage(0, "sighting", "reader"))
        events = await played.count(6)
        await played.end()
    assert [(event.kind, event.reason) for event in events if isinstance(event, RefusedMessage)] == [
        ("frame", "type"),
        ("sighting", "unknown-type"),
        ("sighting", "unknown-type"),
        ("frame", "undecodable"),
        ("sighting", "reader"),
    ]
    assert [event.uid for event in events if isinstance(event, Sighting)] == ["E1"]


async def test_a_message_is_read_by_the_definition_that_held_when_it_came() -> None:
    feed = FeedByHand()
    topics = parse_topics("[[tags]]\ntopic = '/rfid/sightings'\nepc = 'epc'")
    old = b"\0\1\0\0\3\0\0\0E1\0"
    with LiveSource([feed], topics) as source:
        played = await playing(source)
        feed.do("learn", "ward_msgs/msg/Tag", "string epc")
        feed.do("deliver", Message(TAGS, "ward_msgs/msg/Tag", 0, old))
        feed.do("learn", "ward_msgs/msg/Tag", "uint32 antenna\nstring epc")
        feed.do("deliver", Message(TAGS, "ward_msgs/msg/Tag", 0, b"\0\1\0\0\7\0\0\0\3\0\0\0E2\0"))
        events = await played.count(2)
        await played.end()
    assert [event.uid for event in events if isinstance(event, Sighting)] == ["E1", "E2"]


async def test_a_feed_that_is_gone_for_good_ends_the_stream_after_everything_that_came_before() -> None:
    feed = FeedByHand()
    with LiveSource([feed], Topics()) as source:
        played = await playing(source)
        feed.frame(0)
        feed.do("fail", BlockRobotError("FEED_UNREACHABLE", "It is gone."))
        with pytest.raises(BlockRobotError, match=r"FEED_LOST: It is gone\."):
            await asyncio.wait_for(played.task, 5)
    assert len(played.events) == 1


async def test_readings_of_a_reader_of_its_own_stand_beside_the_cameras_frames() -> None:
    camera, reader = FeedByHand(), FeedByHand("reader", {})
    told: list[str] = []
    with LiveSource([camera, reader], Topics(tags=()), told.append) as source:
        played = await playing(source)
        camera.frame(0)
        reader.do("sight", Sighting(NOW_MS, NOW_MS, "E9"))
        reader.do("presence", "reader 192.0.2.1", here=False)
        camera.do("miss", DEPTH, 3)
        camera.do("miss", INFO, 5)
        events = await played.count(2)
        await played.end()
    assert [type(event) for event in events] == [Frame, Sighting]
    assert "reader 192.0.2.1 is gone; it is waited for." in told
    assert source.count_intake().gone["reader 192.0.2.1"] == 1
    assert source.count_intake().never_came == {DEPTH: 3}, "nothing was wanted of the other but its focal length"


async def test_a_topic_that_cannot_be_heard_is_said_and_counted_and_the_rest_is_heard() -> None:
    feed, told = FeedByHand(), []
    why = BlockRobotError("MIDDLEWARE_MISSING", "Topic /rfid/sightings carries ward_msgs/msg/Tag.")
    with LiveSource([feed], Topics(), told.append) as source:
        feed.do("unusable", TAGS, why, for_good=True)
        played = await playing(source)
        feed.do("unusable", DEPTH, why, for_good=False)
        feed.do("unusable", INFO, why, for_good=True)
        feed.do("presence", DEPTH, here=True)
        feed.frame(0)
        events = await played.count(3)
        await played.end()
    assert [(one.kind, one.reason) for one in events if isinstance(one, RefusedMessage)] == [
        ("sighting", "type"),
        ("frame", "type"),
    ]
    assert isinstance(events[-1], Frame)
    assert [f"{why.detail} The run goes on without {topic}." in told for topic in (TAGS, DEPTH, INFO)] == [True] * 3
    assert f"{DEPTH} is there." in told


async def test_a_camera_topic_that_can_never_be_heard_ends_the_run() -> None:
    feed = FeedByHand()
    with LiveSource([feed], Topics()) as source:
        played = await playing(source)
        feed.do("unusable", DEPTH, BlockRobotError("MIDDLEWARE_MISSING", "No sensor_msgs."), for_good=True)
        with pytest.raises(BlockRobotError, match=r"FEED_LOST: No sensor_msgs\."):
            await asyncio.wait_for(played.task, 5)


async def test_nobody_who_reads_what_is_said_neither_ends_a_run_nor_reaches_the_feeds_thread() -> None:
    def tell(sentence: str) -> None:
        threads.append(threading.current_thread())
        raise (BrokenPipeError if len(threads) % 2 else ValueError)(sentence)

    feed, threads = FeedByHand(), list[threading.Thread]()
    with LiveSource([feed], Topics(), tell) as source:
        feed.listener.presence("reader", here=False)  # type: ignore[union-attr]
        played = await playing(source)
        feed.do("presence", "reader", here=True)
        feed.frame(0)
        await played.count(1)
        await played.end()
    assert threads == [threading.current_thread()] * len(threads)
    assert len(threads) >= 2


async def test_a_library_that_fails_in_a_way_of_its_own_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_source, "LOOK_EVERY_S", 0.0)

    class Failing(FeedByHand):
        asked_count = 0

        def topics(self) -> dict[str, str]:
            self.asked_count += 1
            if self.asked_count in (2, 3):
                raise RuntimeError("the context is not valid")
            return super().topics()

    feed, told = Failing("graph"), []
    with LiveSource([feed], Topics(), told.append) as source:
        played = await playing(source)
        async with asyncio.timeout(5):
            while "graph answers again." not in told:  # noqa: ASYNC110
                await asyncio.sleep(0)
        await played.end()
    assert "graph does not answer; what is connected goes on." in told


async def test_messages_of_nodes_that_disagree_about_a_type_are_each_read_by_what_came_with_them() -> None:
    feed = FeedByHand()
    topics = parse_topics("[[tags]]\ntopic = '/rfid/sightings'\nepc = 'epc'")
    first, second = b"\0\1\0\0\3\0\0\0E1\0", b"\0\1\0\0\7\0\0\0\3\0\0\0E2\0"
    with LiveSource([feed], topics) as source:
        played = await playing(source)
        for _ in range(2):
            feed.do("deliver", Message(TAGS, "ward_msgs/msg/Tag", 0, first), "string epc")
            feed.do("deliver", Message(TAGS, "ward_msgs/msg/Tag", 0, second), "uint32 antenna\nstring epc")
        events = await played.count(4)
        await played.end()
    assert [event.uid for event in events if isinstance(event, Sighting)] == ["E1", "E2"] * 2


async def test_topics_that_vanish_and_return_are_said_and_do_not_end_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_source, "LOOK_EVERY_S", 0.0)
    feed, told = FeedByHand(), []
    with LiveSource([feed], Topics(), told.append) as source:
        played = await playing(source)
        feed.frame(0)
        for change, sentence in (
            ({TAGS: SIGHTING_TYPE}, f"{DEPTH} is not advertised; it is waited for."),
            ({TAGS: SIGHTING_TYPE, DEPTH: IMAGE_TYPE}, f"{DEPTH} is there."),
        ):
            async with asyncio.timeout(5):
                while source._watches[feed]._there.get(DEPTH) is None:  # noqa: ASYNC110
                    await asyncio.sleep(0)
                feed.advertised = change
                while sentence not in told:  # noqa: ASYNC110
                    await asyncio.sleep(0)
        feed.frame(1)
        await played.count(2)
        await played.end()
    assert source.count_intake().gone == {DEPTH: 1}


def test_a_topic_that_is_there_and_cannot_be_what_it_is_wanted_for_is_refused_and_all_feeds_are_closed() -> None:
    feed = FeedByHand(topics={DEPTH: "std_msgs/msg/String"})
    with pytest.raises(BlockRobotError, match="no image") as refused, LiveSource([feed], Topics()):
        pass
    assert refused.value.code == "TOPICS_INVALID"
    first, second = FeedByHand(), FeedByHand()
    second.refusal = BlockRobotError("FEED_UNREACHABLE", "Nobody is there.")
    with pytest.raises(BlockRobotError, match="FEED_UNREACHABLE"), LiveSource([first, second], Topics()):
        pass
    assert (first.closed_count, second.closed_count) == (1, 1)


@pytest.mark.parametrize(("told", "found"), [(525.0, 525.0), (0.0, None), (float("nan"), None)])
def test_the_focal_length_is_taken_from_the_cameras_info_unless_it_makes_no_sense(
    told: float, found: float | None
) -> None:
    class Camera(FeedByHand):
        def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
            super().open(wanted, listener)
            types = CODEC.store.types
            stamp = types["builtin_interfaces/msg/Time"](0, 0)
            header = types["std_msgs/msg/Header"](stamp, "camera")
            region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            nine, twelve = np.array([told] + [0.0] * 8), np.zeros(12)
            info = types[INFO_TYPE](header, 4, 6, "", np.zeros(0), nine, nine, twelve, 0, 0, region)
            data = bytes(CODEC.store.serialize_cdr(info, INFO_TYPE))
            self.do("deliver", Message(INFO, INFO_TYPE, 0, data))

    with LiveSource([Camera(topics={DEPTH: IMAGE_TYPE, INFO: INFO_TYPE})], Topics(tags=())) as source:
        assert source.focal_px == found


def test_a_live_source_has_no_empty_frames_and_no_past() -> None:
    source = LiveSource([FeedByHand()], Topics())
    with pytest.raises(BlockRobotError, match="background record --source") as refused:
        source.empty_frames()
    assert refused.value.code == "EMPTY_SCENE_MISSING"
    with pytest.raises(BlockRobotError, match="real time"):
        source.events()
    source.shift_to(5)
    assert source.start_ms > NOW_MS - 10**12


def test_frames_of_the_empty_scene_are_taken_for_so_long_and_those_that_cannot_be_used_are_named() -> None:
    class Camera(FeedByHand):
        def topics(self) -> dict[str, str]:
            if self.listener is not None:  # the watch asks while it plays
                for number in range(5):
                    self.frame(number)
                self.listener.deliver(Message(DEPTH, IMAGE_TYPE, 0, b"rubbish"))
            return super().topics()

    with LiveSource([Camera()], Topics(tags=())) as source:
        assert len(record_empty_frames(source, 0.2)) >= 5
    feed = FeedByHand()
    with LiveSource([feed], Topics(tags=())) as source, pytest.raises(BlockRobotError) as refused:
        record_empty_frames(source, 0.05)
    assert refused.value.code == "CAMERA_SILENT"
    assert "none came. Images are on /camera/depth/image_raw." in refused.value.detail


def test_a_sample_tells_how_much_came_of_each_topic_and_keeps_the_first_message_alone() -> None:
    class Talkative(FeedByHand):
        def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
            super().open(wanted, listener)
            for number in range(6):
                self.frame(number)
            listener.deliver(Message("/stranger", IMAGE_TYPE, 0, b""))

    feed = Talkative()
    sample = Sample(feed)
    sample.listen(0.01)
    assert {topic: figures.count for topic, figures in sample.topics.items()} == {DEPTH: 6, TAGS: 0}
    assert sample.samples(DEPTH)[0].encoding == "16UC1"
    assert sample.samples(TAGS) == []
    assert feed.closed_count == 1


def test_a_sample_explains_a_type_by_the_definition_that_came_with_a_message() -> None:
    class Talkative(FeedByHand):
        def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
            super().open(wanted, listener)
            self.do("deliver", Message(TAGS, "ward_msgs/msg/Tag", 0, b"\0\1\0\0\3\0\0\0E1\0"), "string epc")

    sample = Sample(Talkative(topics={TAGS: "ward_msgs/msg/Tag"}))
    sample.listen(0.01)
    assert sample.types_of("ward_msgs/msg/Tag").paths("ward_msgs/msg/Tag") == ["epc"]
    assert sample.samples(TAGS)[0].epc == "E1"


@pytest.mark.parametrize("ros1", [True, False])
def test_a_topic_of_which_nothing_came_is_no_fault_of_a_recording(ros1: bool) -> None:
    """In ROS 1 a type's definition comes with its first message; elsewhere none would ever come."""
    feed = FeedByHand(topics={"/rfid": "ward_msgs/msg/Tag", "/rosout": "rosgraph_msgs/msg/Log"})
    feed.ros1 = ros1
    sample = Sample(feed)
    sample.listen(0.01)
    listed = list_topics(sample)
    (step,) = next_steps(sample, listed)
    draft = draft_topics(sample, listed)
    assert "recording" not in step
    assert ("hold a tag before the reader" in step, "[definitions]" in step) == (ros1, not ros1)
    assert ("No message of /rfid came in 0.01 s" in step) is ros1
    assert '# [[tags]]\n# topic = "/rfid"' in draft
    assert parse_topics(draft) == parse_topics("")
