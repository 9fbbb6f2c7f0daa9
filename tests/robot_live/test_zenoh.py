"""A robot whose ROS 2 speaks Zenoh: a real router and real drivers in processes of their own, heard over the loopback."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import pytest

from clients.robot.sources.live import zenoh
from clients.robot.sources.live.live_feed import CLOSE_MAX_S
from clients.robot.sources.live.live_sampling import Sample
from clients.robot.sources.live.live_source import LOOK_EVERY_S
from clients.robot.sources.live.zenoh import ZenohFeed
from clients.robot.sources.messages.topics import Topics, parse_topics
from consensus.errors import BlockRobotError
from tests.robot_live.listening import WAIT_S, listening
from tests.robot_live.ward import free_port, make_scene
from tests.robot_live.zenoh_graph import ZenohGraph, zenoh_graph
from tests.walking_alone import UID, walking_alone

DEPTH, TAGS = "/camera/depth/image_raw", "/rfid/sightings"
OTHER_HASH = "RIHS01_" + "0" * 64
WARD_TYPE = "ward_msgs/msg/Tag"
WARD = """
[[tags]]
topic = "/rfid/sightings"
epc = "epc"
distance = "range_m"
distance_sigma = 0.1
distance_unit = "m"
"""
WARD_DEFINED = WARD + '[definitions]\n"ward_msgs/msg/Tag" = "std_msgs/Header header\\nstring epc\\nfloat32 range_m"\n'


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ann walks by the camera, 640x480."""
    text = walking_alone("zenoh", 1.5, [(0.0, -0.5, 2.5), (1.5, 0.5, 2.5)], [0.2], frame_rate=4)
    return make_scene(text, UID, tmp_path_factory.mktemp("scene"))


@pytest.fixture
async def graph() -> AsyncIterator[ZenohGraph]:
    """A router."""
    async with zenoh_graph() as graph:
        yield graph


def feed(graph: ZenohGraph, **settings: dict[str, str]) -> ZenohFeed:
    """A feed from that router."""
    return ZenohFeed([graph.endpoint], 0, settings.get("definitions"))


@pytest.mark.smoke
async def test_thirty_frames_a_second_and_readings_arrive_whole_and_in_order(graph: ZenohGraph, scene: Path) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        sent = await graph.publish(scene, rate=30, seconds=3)
        await heard.until(lambda: len(heard.events) >= sum(sent.values()))
        assert heard.source.focal_px == 525.0
    assert sent == {"frames": 90, "readings": 15}
    assert (len(heard.frames), len(heard.sightings), heard.refused) == (90, 15, [])
    assert [frame.sequence for frame in heard.frames] == list(range(90))
    stamps = [frame.captured_at_ms for frame in heard.frames]
    assert stamps == sorted(stamps)
    pictures = np.fromfile(scene.with_suffix(".raw"), dtype=np.uint16).reshape(-1, 480, 640)
    assert np.array_equal(heard.frames[1].depth, pictures[1])
    assert {one.uid for one in heard.sightings} == {UID}
    assert all(one.distance_m and one.sigma_m == pytest.approx(0.1) for one in heard.sightings)
    assert heard.intake.never_came == {}
    assert heard.intake.missed == {}


async def test_a_robot_opens_no_port_by_listening(graph: ZenohGraph) -> None:
    before = listening_sockets()
    async with listening([feed(graph)], Topics()):
        await asyncio.sleep(0.2)
        assert listening_sockets() == before


async def test_topics_are_listed_as_publishers_announce_them(graph: ZenohGraph, scene: Path) -> None:
    await graph.start_drivers(scene, seconds=20, wait=False)
    listed: dict[str, str] = {}
    async with asyncio.timeout(WAIT_S):
        while len(listed) < 3:
            listed = await asyncio.to_thread(feed(graph).topics)
    assert listed == {
        DEPTH: "sensor_msgs/msg/Image",
        TAGS: "blockrobot_msgs/msg/RfidDetection",
        "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    }


async def test_topics_of_publishers_that_do_not_announce_themselves_are_listed_as_they_are_heard(
    graph: ZenohGraph, scene: Path
) -> None:
    await graph.start_drivers(scene, seconds=20, wait=False, announce=False, only=["depth", "tags"])
    listed: dict[str, str] = {}
    async with asyncio.timeout(WAIT_S):
        while len(listed) < 2:
            listed = await asyncio.to_thread(feed(graph).topics)
    assert listed == {DEPTH: "sensor_msgs/msg/Image", TAGS: "blockrobot_msgs/msg/RfidDetection"}
    async with listening([feed(graph)], Topics()) as heard:
        await heard.until(lambda: len(heard.frames) > 3)
        await asyncio.sleep(LOOK_EVERY_S + 0.5)
    assert heard.told_of(DEPTH)[1:] == ([f"{DEPTH} is there."] if heard.told_of(DEPTH) else [])


async def test_a_type_that_is_not_known_or_differs_keeps_nothing_else_from_being_listed(
    graph: ZenohGraph, scene: Path
) -> None:
    told = {"types": {"tags": WARD_TYPE}, "hashes": {"info": OTHER_HASH}}
    await graph.start_drivers(scene, seconds=20, wait=False, **told)
    await until_listed(graph, DEPTH, TAGS, "/camera/depth/camera_info")
    sample = Sample(feed(graph))
    await asyncio.to_thread(sample.listen, 3.0)
    assert {topic: figures.type for topic, figures in sample.topics.items()} == {
        DEPTH: "sensor_msgs/msg/Image",
        TAGS: WARD_TYPE,
        "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo (RIHS01_000000000000)",
    }
    assert sample.topics[DEPTH].count > 3


async def test_what_is_published_in_another_domain_is_not_heard(graph: ZenohGraph, scene: Path) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        await graph.publish(scene, domain=7, wait=False)
    assert heard.events == []


async def test_a_frame_in_an_encoding_that_is_no_depth_is_refused_and_the_next_is_taken(
    graph: ZenohGraph, scene: Path
) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        await graph.publish(scene, only=["depth"], rate=12, images=[{"encoding": "yuv422"}, {"step": 3}, {}])
        await heard.until(lambda: len(heard.events) >= 12)
    assert heard.refused == [("frame", "encoding"), ("frame", "step")] * 4
    assert len(heard.frames) == 4


async def test_a_depth_topic_that_carries_text_is_refused_at_the_start(graph: ZenohGraph, scene: Path) -> None:
    await graph.start_drivers(scene, seconds=20, wait=False, only=["depth"], types={"depth": "std_msgs/msg/String"})
    await until_listed(graph, DEPTH)
    with pytest.raises(BlockRobotError) as caught:
        async with listening([feed(graph)], Topics()):
            pass
    assert caught.value.code == "TOPICS_INVALID"
    assert "no image" in caught.value.detail


async def test_messages_of_another_type_that_come_later_are_refused_one_by_one(graph: ZenohGraph, scene: Path) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        await asyncio.gather(
            graph.publish(scene, only=["depth"], types={"depth": "std_msgs/msg/String"}),
            graph.publish(scene, only=["depth"], hashes={"depth": OTHER_HASH}),
            graph.publish(scene, only=["depth"], hashes={"depth": "TypeHashNotSupported"}),
        )
        await heard.until(lambda: len(heard.events) >= 30)
    assert heard.refused == [("frame", "type")] * 20
    assert len(heard.frames) == 10


async def test_a_type_whose_definition_differs_is_refused_at_the_start_with_both_hashes(
    graph: ZenohGraph, scene: Path
) -> None:
    await graph.start_drivers(scene, seconds=20, wait=False, only=["depth"], hashes={"depth": OTHER_HASH})
    await until_listed(graph, DEPTH)
    with pytest.raises(BlockRobotError) as caught:
        async with listening([feed(graph)], Topics()):
            pass
    assert caught.value.code == "TOPICS_INVALID"
    assert "RIHS01_000000000000" in caught.value.detail
    assert "RIHS01_d31d41a9a4c4" in caught.value.detail
    assert "[definitions]" in caught.value.detail


async def test_a_type_of_ones_own_is_read_by_the_definition_in_the_topics_file_and_not_without(
    graph: ZenohGraph, scene: Path
) -> None:
    await graph.start_drivers(scene, seconds=20, wait=False, only=["tags"], types={"tags": WARD_TYPE})
    await until_listed(graph, TAGS)
    with pytest.raises(BlockRobotError) as caught:
        async with listening([feed(graph)], parse_topics(WARD)):
            pass
    assert caught.value.code == "TOPICS_INVALID"
    assert WARD_TYPE in caught.value.detail
    topics = parse_topics(WARD_DEFINED)
    async with listening([feed(graph, definitions=dict(topics.definitions))], topics) as heard:
        await heard.until(lambda: len(heard.sightings) > 2)
    assert {one.uid for one in heard.sightings} == {UID}
    assert heard.refused == []


async def test_what_was_lost_on_the_way_is_counted_by_the_publishers_numbers(graph: ZenohGraph, scene: Path) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        await graph.publish(scene, rate=25, only=["depth"], skip_every=5)
        await heard.until(lambda: len(heard.frames) >= 20)
    assert heard.intake.never_came == {DEPTH: 4}


async def test_a_publisher_that_is_killed_and_one_that_follows_are_one_run(graph: ZenohGraph, scene: Path) -> None:
    drivers = await graph.start_drivers(scene, seconds=60, wait=False)
    await until_listed(graph, DEPTH)
    async with listening([feed(graph)], Topics()) as heard:
        await heard.until(lambda: len(heard.frames) > 5)
        drivers.kill()
        await drivers.communicate()
        await heard.until(lambda: heard.intake.gone.get(DEPTH) == 1)
        before = len(heard.frames)
        await graph.start_drivers(scene, seconds=60)
        await heard.until(lambda: len(heard.frames) > before + 5)
        await heard.until(lambda: f"{DEPTH} is there." in heard.said)
    assert heard.intake.gone[DEPTH] == 1


async def test_a_router_that_is_killed_and_comes_back_is_found_again(graph: ZenohGraph, scene: Path) -> None:
    async with listening([feed(graph)], Topics()) as heard:
        await graph.start_drivers(scene, seconds=150)
        await heard.until(lambda: len(heard.frames) > 5)
        await graph.kill_router()
        await asyncio.sleep(0.5)
        before = len(heard.frames)
        await graph.start_router()
        await heard.until(lambda: len(heard.frames) > before + 5)


async def test_where_nobody_answers_a_robot_says_so_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh, "OPEN_MAX_S", 1.0)
    began = time.monotonic()
    with pytest.raises(BlockRobotError) as caught:
        await asyncio.to_thread(ZenohFeed([f"tcp/127.0.0.1:{free_port()}"]).topics)
    assert caught.value.code == "FEED_UNREACHABLE"
    assert 0.9 < time.monotonic() - began < 4


async def test_a_router_that_hangs_does_not_keep_a_robot_from_leaving(graph: ZenohGraph) -> None:
    opened = feed(graph)
    async with listening([opened], Topics()):
        assert graph.router is not None
        graph.router.send_signal(19)  # SIGSTOP
        await asyncio.sleep(0.1)
        began = time.monotonic()
    assert time.monotonic() - began < CLOSE_MAX_S
    opened.close()


async def until_listed(graph: ZenohGraph, *topics: str) -> None:
    """Return once topics are announced."""
    async with asyncio.timeout(WAIT_S):
        while not {*topics} <= (await asyncio.to_thread(feed(graph).topics)).keys():
            pass


def listening_sockets() -> set[str]:
    """The addresses at which this process listens, or takes datagrams."""
    own = set()
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the one by which the folder is listed
            own.add(str(entry.readlink()))
    found = set()
    for table, is_open in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            parts = line.split()
            if parts[3] == is_open and f"socket:[{parts[9]}]" in own:
                found.add(f"{table} {parts[1]}")
    return found
