"""The ROS 2 feed beside real publishers, over Fast DDS: what is heard, what is not, and what comes back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.robot_live.own_network import run_in_own_network
from tests.robot_live.ros2_graph import DEPTH, RFID, TAG_TYPE, Ros2Graph, ros2_graph
from tests.robot_live.ros2_wheels import install, sourced
from tests.robot_live.ward import published_counts

pytestmark = pytest.mark.ros2

IMAGE, TEXT = "sensor_msgs/msg/Image", "std_msgs/msg/String"
BARE_TAGS = f'[depth]\ntopic = "{DEPTH}"\n[[tags]]\ntopic = "{RFID}"\nepc = "data"\n'
ON_GRAPH = Callable[[Callable[[Ros2Graph], Awaitable[None]]], None]


@pytest.fixture
def on_graph(tmp_path: Path, request: pytest.FixtureRequest) -> ON_GRAPH:
    """Runs a story on an empty graph."""
    workspace = getattr(request, "param", True)
    home = tmp_path / "home"
    home.mkdir()

    def run(story: Callable[[Ros2Graph], Awaitable[None]]) -> None:
        async def within() -> None:
            async with ros2_graph(home, workspace=workspace) as graph:
                await story(graph)

        run_in_own_network(within, tmp_path)

    return run


def heard(topic: str, type_name: str, count: int = 1) -> Callable[[dict[str, Any]], bool]:
    return lambda state: state["heard"].get(f"{topic} {type_name}", 0) >= count


def test_every_frame_and_every_reading_of_reliable_drivers_arrives_within_a_frame_or_two(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        drivers, ear = await asyncio.gather(
            graph.talk(seconds=3, rate=30, tags="ward", reads_per_s=10), graph.listen({DEPTH: "", RFID: ""})
        )
        published = await published_counts(drivers)
        assert published == {"frames": 90, "tag_messages": 30}
        state = await ear.until("state", lambda state: sum(state["events"].values()) >= 120)

        assert state["heard"] == {f"{DEPTH} {IMAGE}": 90, f"{RFID} {TAG_TYPE}": 30}
        assert state["events"] == {"Frame": 90, "Sighting": 30}
        assert (state["lost"], state["failures"]) == ({}, [])
        assert state["shape"] == [480, 640]
        assert state["late_ms"] < 500

    on_graph(story)


def test_it_closes_at_once_and_leaves_no_thread_no_file_and_the_signal_handlers_as_they_were(
    on_graph: ON_GRAPH,
) -> None:
    async def story(graph: Ros2Graph) -> None:
        _, ear = await asyncio.gather(
            graph.talk(seconds=20, tags="text"), graph.listen({DEPTH: IMAGE, RFID: TEXT}, topics=BARE_TAGS)
        )
        await ear.until("state", heard(DEPTH, IMAGE, 5))
        end = await ear.ask("close")

        assert end["closed_in_s"] < 2
        assert (end["threads"], end["handlers_kept"], end["failures"]) == (1, True, [])
        assert end["logs"] == []
        assert await ear.process.wait() == 0

    on_graph(story)


def test_what_is_listed_is_what_has_a_publisher_in_the_domain(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        graph.environment["ROS_DOMAIN_ID"] = "7"
        drivers = await graph.talk(seconds=20, tags="ward", wait=False)
        del graph.environment["ROS_DOMAIN_ID"]
        ear = await graph.listen({"/never": TEXT}, look_first=True, domain=7)
        before = (await ear.answer())["topics"]
        assert await ear.answer() == {"opened": True}
        drivers.terminate()
        await ear.until("topics", lambda topics: topics == {})

        assert (before[DEPTH], before[RFID]) == (IMAGE, TAG_TYPE)
        assert "/never" not in before

    on_graph(story)


def test_drivers_are_heard_that_start_later_that_end_and_return_and_that_are_killed_and_return(
    on_graph: ON_GRAPH,
) -> None:
    async def story(graph: Ros2Graph) -> None:
        ear = await graph.listen({DEPTH: "", RFID: ""})
        assert await ear.ask("topics") == {}
        for end in ("ended", "killed", "last"):
            drivers = await graph.talk(seconds=20, tags="ward", node=f"drivers_{end}")
            count = (await ear.ask("state"))["heard"].get(f"{DEPTH} {IMAGE}", 0)
            state = await ear.until("state", heard(DEPTH, IMAGE, count + 15))
            assert state["failures"] == []
            if end == "ended":
                drivers.terminate()
                await ear.until("topics", lambda topics: topics == {})
            else:
                drivers.kill()

        assert set(state["events"]) == {"Frame", "Sighting"}
        assert [name for name, _ in state["learnt"]].count(IMAGE) == 1, "the subscription outlived its publishers"

    on_graph(story)


def test_drivers_of_either_reliability_are_heard_even_where_it_changes(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        ear = await graph.listen({RFID: ""}, topics=BARE_TAGS)
        for reliable in (True, False, True):
            drivers = await graph.talk(seconds=20, tags="text", reads_per_s=30, reliable=reliable, wait=False)
            count = (await ear.ask("state"))["heard"].get(f"{RFID} {TEXT}", 0)
            state = await ear.until("state", heard(RFID, TEXT, count + 10))
            drivers.terminate()
            await ear.until("topics", lambda topics: topics == {})

        assert len(state["learnt"]) >= 2, "a reliable subscription hears no best effort: it was made anew"

    on_graph(story)


@pytest.mark.parametrize("is_large_data", [False, True])
def test_of_large_frames_best_effort_loses_many_and_tells_unless_both_sides_use_the_transports_for_large_data(
    on_graph: ON_GRAPH, is_large_data: bool
) -> None:
    async def story(graph: Ros2Graph) -> None:
        if is_large_data:
            graph.environment["FASTDDS_BUILTIN_TRANSPORTS"] = "LARGE_DATA"
        ear = await graph.listen({DEPTH: ""})  # first: with TCP, two that start in the same moment may never meet
        drivers = await graph.talk(seconds=2, rate=30, reliable=False)
        published = (await published_counts(drivers))["frames"]
        if is_large_data:
            await ear.until("state", heard(DEPTH, IMAGE, published))
        state = await ear.ask("close")

        came, lost = state["heard"].get(f"{DEPTH} {IMAGE}", 0), state["lost"].get(DEPTH, 0)
        if is_large_data:
            assert (came, lost) == (published, 0)
        else:
            assert came < published
            assert published / 2 < came + lost <= published, "but for the last, whose loss nothing shows"

    on_graph(story)


def test_frames_that_cannot_be_used_are_refused_one_by_one_and_the_good_between_them_are_kept(
    on_graph: ON_GRAPH,
) -> None:
    async def story(graph: Ros2Graph) -> None:
        acts = [
            {"image": {"encoding": "rgb8"}},
            {"image": {"step": 3}},
            {},
            {"image": {"height": 481}},
            {"image": {"width": 70_000}},
            {"image": {"is_bigendian": 1}},
            {"raw": "00010000ffffffff"},
            {"raw": "0001"},
        ]
        ear, drivers = await asyncio.gather(graph.listen({DEPTH: IMAGE}), graph.talk(seconds=0.2, rate=20, acts=acts))
        published = await published_counts(drivers)
        assert published["frames"] == 4 * len(acts)
        await ear.until("state", lambda state: sum(state["events"].values()) >= published["frames"])
        state = await ear.ask("close")

        refused = {"frame: encoding": 4, "frame: step": 4, "frame: size": 8, "frame: undecodable": 8}
        assert state["events"] == {**refused, "Frame": 8}
        assert state["failures"] == []

    on_graph(story)


def test_a_topic_that_carries_another_type_than_told_is_heard_and_refused_as_such(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        ear, _ = await asyncio.gather(graph.listen({DEPTH: IMAGE}), graph.talk(seconds=20, text_for_depth=True))
        state = await ear.until("state", heard(DEPTH, TEXT, 5))

        assert set(state["events"]) == {"frame: type"}

    on_graph(story)


@pytest.mark.parametrize("on_graph", [False], indirect=True)
def test_a_type_whose_package_is_not_sourced_is_refused_with_what_to_source(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        ear = await graph.listen({DEPTH: IMAGE, RFID: TAG_TYPE}, look_first=True)
        await ear.answer()
        answer = await ear.answer()

        assert (answer["refused"], answer["threads"]) == ("MIDDLEWARE_MISSING", 1)
        assert f"Topic {RFID} carries {TAG_TYPE}" in answer["detail"]
        assert "first source the workspace that has ward_msgs" in answer["detail"]

    on_graph(story)


@pytest.mark.parametrize("on_graph", [False], indirect=True)
def test_a_type_without_package_that_appears_later_is_told_and_the_rest_is_heard(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        ear = await graph.listen({DEPTH: "", RFID: ""})
        graph.environment["PYTHONPATH"] = sourced(install())["PYTHONPATH"]
        await graph.talk(seconds=20, tags="ward", wait=False)
        state = await ear.until("state", heard(DEPTH, IMAGE, 20))

        (told,) = state["unusable"]
        assert (told[0], told[1], told[3]) == (RFID, "MIDDLEWARE_MISSING", True)
        assert "ward_msgs" in told[2]
        assert state["failures"] == [], "the feed is there"

    on_graph(story)


def test_a_type_that_was_built_of_another_version_is_refused_rather_than_misread_until_its_publisher_ends(
    on_graph: ON_GRAPH,
) -> None:
    async def story(graph: Ros2Graph) -> None:
        other, ear = await asyncio.gather(
            graph.talk(seconds=100, tags="ward", tags_hash="ab" * 32, wait=False), graph.listen({RFID: ""})
        )
        state = await ear.until("state", lambda state: state["unusable"])

        topic, _, detail, is_for_good = state["unusable"][0]
        assert (topic, is_for_good) == (RFID, False)
        assert "built with another version of ward_msgs/msg/TagArray" in detail
        assert (state["heard"], state["failures"]) == ({}, [])
        other.terminate()  # it takes its leave; one that is killed stays listed for 20 s
        await graph.talk(seconds=100, tags="ward", wait=False, node="good")
        state = await ear.until("state", heard(RFID, TAG_TYPE, 3))
        assert (state["there"], state["failures"]) == ([RFID], [])

    on_graph(story)


def test_definitions_of_all_types_that_ros_2_ships_have_the_hash_that_ros_2_announces(on_graph: ON_GRAPH) -> None:
    async def story(graph: Ros2Graph) -> None:
        process = await graph.start("-m", "tests.robot_live.ros2_hashes")
        counts = await published_counts(process)

        assert counts["types"] > 100
        assert counts["others"] == []

    on_graph(story)
