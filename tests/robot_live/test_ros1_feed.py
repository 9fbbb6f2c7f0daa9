"""A real ROS 1 graph misbehaves as robots do: topics come and go, nodes and the master are killed, messages are wrong."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import time
import xmlrpc.client
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from clients.robot.sources.live.ros1 import Ros1Feed
from clients.robot.sources.messages.topics import load_topics
from consensus.errors import BlockRobotError
from tests.cluster.killed_robot import ROOT
from tests.robot_live.ros1_graph import Ros1Graph, ros1_graph
from tests.robot_live.ward import TOPICS_FILE, make_scene, published_counts
from tests.walking_alone import UID, walking_alone

SCENE = walking_alone("small", 0.4, [(0.0, -0.2, 3.0), (0.4, 0.2, 3.0)], [0.1, 0.3], frame_rate=10, size=(320, 240))
WAIT_S = 30.0
NOBODY_RATE_HZ = 10
STORM_PER_S = 10_000
STORM_S = 4.0

pytestmark = pytest.mark.system_packages


class Ear:
    """What the robot hears, in its process."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.state: dict[str, Any] = {}

    async def until(self, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return what it says once something is so."""
        assert self.process.stdout is not None
        try:
            async with asyncio.timeout(WAIT_S):
                async for line in self.process.stdout:
                    self.state = json.loads(line)
                    if is_so(self.state):
                        return self.state
        except TimeoutError:
            pass
        raise AssertionError(f"it never came to that: {self.state}")

    async def more(self, count: int = 10) -> dict[str, Any]:
        """Return what it says once so many more frames came."""
        now = (await self.until(lambda _: True))["frames"]
        return await self.until(lambda state: state["frames"] >= now + count)

    async def close(self) -> dict[str, Any]:
        """End it; return the last of what it says."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        last = await self.until(lambda state: "closed" in state)
        await asyncio.wait_for(self.process.wait(), WAIT_S)
        return last


@contextlib.asynccontextmanager
async def ear(graph: Ros1Graph, topics: str = TOPICS_FILE) -> AsyncIterator[Ear]:
    kept = {name: value for name, value in graph.environment.items() if not name.startswith("ROS")}
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "tests.robot_live.ros1_ear", json.dumps({"uri": graph.uri, "topics": topics})),
        env={**kept, "HOME": str(graph.folder)},
        cwd=ROOT,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=None,
        limit=1 << 20,
    )
    try:
        yield Ear(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_scene(SCENE, UID, tmp_path_factory.mktemp("scene"))


def _logs_of_robot(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob("*.log") if "blockrobot" in path.name]


def drivers(graph: Ros1Graph, scene: Path, **settings: Any) -> Any:
    return graph.start_drivers(scene, **{"rate": NOBODY_RATE_HZ, "seconds": 100, "wait": False, **settings})


@pytest.mark.smoke
async def test_messages_of_a_type_of_the_robots_own_are_read_by_what_their_publisher_says_of_it(
    scene: Path, tmp_path: Path
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene)
        state = await heard.until(lambda state: state["frames"] > 10 and state["sightings"] > 3)
        assert state["latest"]["uid"] == UID
        assert 2.5 < state["latest"]["distance_m"] < 3.5
        assert (state["shape"], state["refused"]) == ([240, 320], {})
        assert state["focal_px"] == 525.0


async def test_nothing_listens_beyond_this_machine_and_no_log_is_written(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene)
        await heard.more()
        listing = await asyncio.create_subprocess_exec("ss", "-Hltnp", stdout=asyncio.subprocess.PIPE)
        lines = (await listing.communicate())[0].decode().splitlines()
        ours = {str(process.pid) for process in [heard.process, graph.master, *graph.drivers] if process is not None}
        addresses = [line.split()[3] for line in lines if any(f"pid={pid}," in line for pid in ours)]
        assert len(addresses) >= 3
        assert [address for address in addresses if not address.startswith("127.0.0.1:")] == []
        await heard.close()
    assert _logs_of_robot(tmp_path) == []


async def test_a_topic_that_vanishes_and_returns_is_said_and_goes_on(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        first = await drivers(graph, scene)
        await heard.more()
        first.terminate()
        await first.wait()
        await heard.until(lambda state: state["intake"]["gone"].get("/kinect/depth/image") == 1)
        # A driver takes its topics back one after the other.
        state = await heard.until(lambda state: "/rfid is not advertised; it is waited for." in state["said"])
        back_count = state["said"].count("/kinect/depth/image is there.")
        await drivers(graph, scene)
        await heard.more()
        await heard.until(lambda state: state["said"].count("/kinect/depth/image is there.") == back_count + 1)


async def test_drivers_that_are_killed_and_started_again_are_heard_again(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        first = await drivers(graph, scene)
        await heard.more()
        first.kill()
        await first.wait()
        await heard.until(lambda state: "/kinect/depth/image is silent: no frame for 5 s." in state["said"])
        await drivers(graph, scene)
        await heard.more()
        await heard.until(lambda state: any("is heard again" in sentence for sentence in state["said"]))


async def test_a_master_that_is_killed_leaves_what_is_connected_and_its_successor_is_told_of_us(
    scene: Path, tmp_path: Path
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        first = await drivers(graph, scene)
        await heard.more()
        await graph.kill_master()
        await heard.until(lambda state: any("does not answer; what is connected" in told for told in state["said"]))
        await heard.more()
        await graph.start_master()
        await heard.until(lambda state: any(told.endswith(" answers again.") for told in state["said"]))
        first.kill()
        await first.wait()
        await drivers(graph, scene)  # these know the new master alone, which rospy by itself would never tell of us
        await heard.more()


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        ({"encoding": "bayer_rggb8"}, "frame encoding"),
        ({"encoding": "32FC1"}, "frame step"),
        ({"step": 5}, "frame step"),
        ({"step": 1000}, "frame size"),
        ({"width": 70_000}, "frame size"),
    ],
)
async def test_images_that_contradict_themselves_are_refused_by_reason(
    scene: Path, tmp_path: Path, image: dict[str, Any], reason: str
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        bad = await drivers(graph, scene, image=image)
        state = await heard.until(lambda state: sum(state["refused"].values()) >= 5)
        assert (list(state["refused"]), state["frames"]) == ([reason], 0)
        bad.kill()
        await drivers(graph, scene)
        await heard.more()


async def test_the_order_of_bytes_is_what_the_message_says(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene, image={"is_bigendian": 1})
        wrong = await heard.more()  # these are little-endian, and say that they are not
        right = int.from_bytes(wrong["middle_mm"].to_bytes(2, "little"), "big")
        assert wrong["middle_mm"] != right
        assert 2_000 < right < 5_500


async def test_a_type_that_was_changed_is_read_by_its_new_definition(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        first = await drivers(graph, scene)
        before = await heard.until(lambda state: state["sightings"] > 3)
        first.kill()
        await first.wait()
        await drivers(graph, scene, other_tags=True, clock_offset_s=0.0)
        after = await heard.until(lambda state: state["sightings"] > before["sightings"] + 3)
        assert after["refused"] == {}
        assert after["latest"]["uid"] == UID
        assert abs(after["latest"]["distance_m"] - before["latest"]["distance_m"]) < 0.5


async def test_a_topic_of_another_type_than_told_is_refused_at_the_start_or_message_by_message(
    scene: Path, tmp_path: Path
) -> None:
    told = TOPICS_FILE.replace('topic = "/rfid"', 'topic = "/rfid"\ntype = "ward_msgs/msg/TagArray"')
    async with ros1_graph(tmp_path) as graph, ear(graph, told) as heard:
        await heard.until(lambda state: "frames" in state)
        first = await drivers(graph, scene, tags_are_text=True)
        state = await heard.until(lambda state: state["refused"].get("sighting type", 0) > 3)
        assert state["frames"] > 0
        async with ear(graph, told) as late:
            refused = await late.until(lambda state: "code" in state)
            assert refused["code"] == "TOPICS_INVALID"
            assert "/rfid carries std_msgs/msg/String" in refused["detail"]
        first.kill()


@pytest.mark.parametrize("offset_s", [86_400.0, -3_600.0])
async def test_a_robot_whose_clock_is_wrong_is_set_right_by_when_messages_came(
    scene: Path, tmp_path: Path, offset_s: float
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene, clock_offset_s=offset_s)
        state = await heard.until(lambda state: state["frames"] > 30 and state["sightings"] > 10)
        assert abs(state["offsets_ms"]["camera"] + 1000 * offset_s) < 200
        assert state["admitted"] > 30


@pytest.mark.parametrize("stamps", ["equal", "backwards"])
async def test_stamps_that_stand_still_or_go_back_end_nothing(scene: Path, tmp_path: Path, stamps: str) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        first = await drivers(graph, scene, stamps=stamps)
        await heard.until(lambda state: state["frames"] > 20 and state["sightings"] > 10)
        first.kill()
        await first.wait()
        await drivers(graph, scene)
        before = heard.state["admitted"]
        state = await heard.more(30)
        assert state["admitted"] > before + 20


async def test_a_message_larger_than_any_image_ends_its_connection_and_not_the_robots_memory(
    scene: Path, tmp_path: Path
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene, node="good")
        before = await heard.more()
        await drivers(graph, scene, node="evil", rate=2, more_bytes=400 << 20, reads_per_s=2)
        state = await heard.more(100)
        assert state["refused"] == {}, "it never became a message"
        assert state["peak_mb"] - before["peak_mb"] < 300


async def test_topics_are_listed_and_drafted_from_what_is_on_the_air(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph:
        await drivers(graph, scene)
        async with asyncio.timeout(WAIT_S):
            while not {"/kinect/depth/image", "/rfid"} <= await asyncio.to_thread(_advertised, graph.uri):
                pass
        draft = tmp_path / "draft.toml"
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "network.cli.main", "robot", "topics", "--source", "ros1"),
            *("--ros-master", graph.uri, "--seconds", "4", "--draft", str(draft), "--json"),
            env={**os.environ, "HOME": str(tmp_path), "BLOCKROBOT_HOME": str(tmp_path)},
            cwd=ROOT,
            stdout=asyncio.subprocess.PIPE,
        )
        output, _ = await asyncio.wait_for(process.communicate(), 2 * WAIT_S)
        listed = {row["topic"]: row for row in json.loads(output)["topics"]}
        depth, tags = listed["/kinect/depth/image"], listed["/rfid"]
        assert (depth["encoding"], depth["could_be"], depth["type"]) == ("16UC1", ["depth"], "sensor_msgs/msg/Image")
        assert abs(depth["rate_hz"] - NOBODY_RATE_HZ) < 2
        assert (tags["type"], tags["could_be"]) == ("ward_msgs/msg/TagArray", ["tags"])
        assert load_topics(draft).tags[0].map.epc == "tags[].epc"
        assert UID.encode() not in output


async def test_a_storm_of_readings_is_heard_whole_or_counted_and_leaves_memory_as_it_was(
    scene: Path, tmp_path: Path
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        calm = await drivers(graph, scene)
        before = await heard.more()
        calm.kill()
        await calm.wait()
        storm = await graph.start_drivers(
            scene, rate=NOBODY_RATE_HZ, seconds=STORM_S, storm_per_s=STORM_PER_S, node="storm"
        )
        counts = await published_counts(storm)
        assert counts["readings"] >= STORM_PER_S * STORM_S
        all_frames = before["frames"] + counts["frames"]
        state = await heard.until(
            lambda state: (
                state["intake"]["heard"]["/rfid"] >= counts["tag_messages"]
                and state["frames"] + state["intake"]["missed"].get("frame", 0) >= all_frames
            )
        )
        await asyncio.sleep(1)
        state = await heard.close()
        assert state["sightings"] + 10 * state["intake"]["missed"].get("sighting", 0) >= counts["readings"]
        assert state["uids"] == 401
        assert state["peak_mb"] - before["peak_mb"] < 200


async def test_a_robot_leaves_in_time_whatever_the_master_does(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene)
        await heard.more()
        assert graph.master is not None
        os.kill(graph.master.pid, signal.SIGSTOP)
        began = time.monotonic()
        await heard.close()
        assert time.monotonic() - began < 15
        assert heard.process.returncode == 0


async def test_a_robot_whose_node_somebody_shuts_down_says_so_and_ends(scene: Path, tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene)
        await heard.more()
        await asyncio.to_thread(_rosnode_kill, graph.uri)
        said = await heard.until(lambda state: "code" in state)  # a line that is no JSON would end this
        assert said["code"] == "FEED_LOST"
        assert "rosnode kill" in said["detail"]
        assert await asyncio.wait_for(heard.process.wait(), WAIT_S) == 0


def _advertised(master_uri: str) -> set[str]:
    with xmlrpc.client.ServerProxy(master_uri) as master:
        _, _, (publishers, _, _) = master.getSystemState("/test")  # type: ignore[misc]
    return {str(topic) for topic, _ in publishers}  # type: ignore[union-attr]


def _rosnode_kill(master_uri: str) -> None:
    with xmlrpc.client.ServerProxy(master_uri) as master:
        _, _, (_, subscribers, _) = master.getSystemState("/rosnode")  # type: ignore[misc]
        nodes = {str(node) for _, named in subscribers for node in named}  # type: ignore[union-attr]
        (robot,) = [node for node in nodes if node.startswith("/blockrobot")]
        _, _, uri = master.lookupNode("/rosnode", robot)  # type: ignore[misc]
    with xmlrpc.client.ServerProxy(str(uri)) as node:
        node.shutdown("/rosnode", "killed")


async def test_publishers_that_disagree_about_a_type_are_each_read_by_their_own_definition(
    scene: Path, tmp_path: Path
) -> None:
    async with ros1_graph(tmp_path) as graph, ear(graph) as heard:
        await drivers(graph, scene, node="first", reads_per_s=50)
        await heard.until(lambda state: state["sightings"] > 3)
        one = heard.state["latest"]["distance_m"]
        await drivers(graph, scene, node="second", reads_per_s=50, other_tags=True)
        before = heard.state["sightings"]
        state = await heard.until(lambda state: state["sightings"] > before + 200)
        assert (state["refused"], state["uids"]) == ({}, 1)
        assert abs(state["latest"]["distance_m"] - one) < 1


async def test_a_robot_that_finds_no_master_says_where_it_looked(tmp_path: Path) -> None:
    async with ros1_graph(tmp_path) as graph:
        await graph.kill_master()
        async with ear(graph) as heard:
            said = await heard.until(lambda state: "code" in state)
            assert said["code"] == "FEED_UNREACHABLE"
            assert graph.uri in said["detail"]


async def test_a_master_that_dies_while_a_robot_joins_is_given_up_with_nothing_on_standard_output(
    scene: Path, tmp_path: Path
) -> None:
    async with (
        ros1_graph(tmp_path) as graph,
        _answering(graph.port, 2) as port,
        ear(Ros1Graph(tmp_path, port)) as heard,
    ):
        said = await heard.until(lambda state: "code" in state)  # a line that is no JSON would end this
        assert said["code"] == "FEED_UNREACHABLE"
        assert await asyncio.wait_for(heard.process.wait(), WAIT_S) == 0


@contextlib.asynccontextmanager
async def _answering(master_port: int, count: int) -> AsyncIterator[int]:
    """A port that leads to a master for so many calls, and then hangs up."""
    calls = 0

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal calls
        calls += 1
        if calls <= count:
            inwards, outwards = await asyncio.open_connection("127.0.0.1", master_port)
            both = [asyncio.create_task(_pump(reader, outwards)), asyncio.create_task(_pump(inwards, writer))]
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            for task in both:
                task.cancel()
            outwards.close()
        writer.close()

    server = await asyncio.start_server(pass_on, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(1 << 16):
        writer.write(data)
        await writer.drain()


def test_a_master_that_takes_calls_and_never_answers_is_given_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        feed = Ros1Feed(f"http://127.0.0.1:{server.getsockname()[1]}")
        began = time.monotonic()
        with pytest.raises(BlockRobotError) as refused:
            feed.topics()
        assert refused.value.code == "FEED_UNREACHABLE"
        assert time.monotonic() - began < 10
