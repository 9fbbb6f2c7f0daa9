"""A person walks before a robot that runs, over each middleware, and its command measures how its antennas are turned."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from clients.robot.identity.robot_keys import create_identity
from clients.robot.synthetic.scenario import parse_scenario
from tests.robot_live.live_robot import LiveCommands
from tests.robot_live.own_network import run_in_own_network
from tests.robot_live.ros1_graph import ros1_graph
from tests.robot_live.ros2_graph import ros2_graph
from tests.robot_live.ward import TOPICS_FILE, make_scene
from tests.robot_live.zenoh_graph import zenoh_graph
from tests.walking_alone import UID, walking_alone

RATE_HZ = 15
LAP_S = 4.0
WALK_S = 16
OFFSET_DB, SLOPE_DB_PER_DEG = 3.0, 0.6
TWO_ANTENNAS = {"rate": RATE_HZ, "reads_per_s": RATE_HZ, "seconds": 90, "wait": False}
"""A reading with each frame, by one antenna after the other; longer than the command watches."""

SCENE = walking_alone(
    "antennas",
    LAP_S,
    [(0.0, -0.95, 2.3), (LAP_S, 0.95, 2.3)],
    [0.1, LAP_S - 0.1],
    frame_rate=RATE_HZ,
    size=(320, 240),
    focal_px=262.0,
)


@pytest.fixture
def walk(tmp_path: Path) -> tuple[Path, Path]:
    """Ann from side to side, heard by two antennas as they are turned; and the corridor without her."""
    scene, empty = (make_scene(SCENE, UID, tmp_path / "scene", empty=empty) for empty in (False, True))
    told = json.loads(scene.read_text(encoding="utf-8"))
    (ann,) = parse_scenario(SCENE).people
    for number, reading in enumerate(told["readings"]):
        place = ann.place(number / RATE_HZ)
        assert place is not None
        contrast_db = OFFSET_DB + SLOPE_DB_PER_DEG * math.degrees(math.atan2(*place))
        reading["antenna"] = 1 + number % 2
        reading["rssi_dbm"] = -55.0 + (contrast_db if number % 2 else 0.0)
    scene.write_text(json.dumps(told), encoding="utf-8")
    return scene, empty


def commands_of(
    folder: Path, source: tuple[str, ...], environment: Mapping[str, str], topics: str = TOPICS_FILE
) -> LiveCommands:
    """The commands of a robot that knows no network yet."""
    create_identity(folder / "robots" / "robot")
    return LiveCommands(folder, topics, source, environment, folder / "robots")


async def check_measured(commands: LiveCommands, reader: str) -> None:
    answer = await commands.measure_antennas(WALK_S)
    (pair,) = answer["pairs"]
    assert (pair["reader"], pair["left"], pair["right"]) == (reader, 1, 2)
    assert pair["slope_db_per_deg"] == pytest.approx(SLOPE_DB_PER_DEG, abs=0.06)
    assert pair["offset_db"] == pytest.approx(OFFSET_DB, abs=1.0)
    assert pair["sigma_deg"] < 8
    assert answer["turn_deg"] > 25


@pytest.mark.system_packages
async def test_over_ros_1(tmp_path: Path, walk: tuple[Path, Path]) -> None:
    scene, empty = walk
    async with ros1_graph(tmp_path / "ros") as graph:
        kept = {name: value for name, value in graph.environment.items() if name not in ("ROS_IP", "ROS_HOME")}
        commands = commands_of(tmp_path, ("--source", "ros1"), kept)
        nobody = await graph.start_drivers(empty, **{**TWO_ANTENNAS, "reads_per_s": 0})
        await commands.approve_viewpoint()
        nobody.terminate()
        await nobody.wait()
        await graph.start_drivers(scene, **TWO_ANTENNAS)
        await check_measured(commands, "/rfid")


@pytest.mark.ros2
def test_over_ros_2(tmp_path: Path, walk: tuple[Path, Path]) -> None:
    scene, empty = walk

    async def story() -> None:
        async with ros2_graph(tmp_path / "ros") as graph:
            commands = commands_of(tmp_path, ("--source", "ros2"), graph.environment)
            nobody = await graph.talk(**TWO_ANTENNAS, scene=str(empty))
            await commands.approve_viewpoint()
            nobody.terminate()
            await nobody.wait()
            await graph.talk(**TWO_ANTENNAS, scene=str(scene), tags="ward")
            await check_measured(commands, "/rfid")

    run_in_own_network(story, tmp_path)


async def test_over_zenoh(tmp_path: Path, walk: tuple[Path, Path]) -> None:
    scene, empty = walk
    async with zenoh_graph() as graph:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}
        source = ("--source", "zenoh", "--zenoh-connect", graph.endpoint)
        commands = commands_of(tmp_path, source, environment, topics="")
        nobody = await graph.start_drivers(empty, **TWO_ANTENNAS, only=["depth"])
        await commands.approve_viewpoint()
        nobody.kill()
        await graph.start_drivers(scene, **TWO_ANTENNAS)
        await check_measured(commands, "/rfid/sightings")
