"""How long the robot looks around in a ROS 2 graph before it lists what is advertised, in virtual time."""

from __future__ import annotations

from collections.abc import Sequence

from clients.robot.sources.live.ros2 import LOOK_MAX_S, LOOK_MIN_S, OWN_TOPIC, SETTLED_S, Discovery

NOBODY: dict[str, str] = {}
NEIGHBOUR = {OWN_TOPIC: "rcl_interfaces/msg/ParameterEvent"}
CAMERA = {"/depth": "sensor_msgs/msg/Image"}
STARTED_S = 1_000.0
STEP_S = 0.05


def look_around(*appearing: tuple[float, dict[str, str]]) -> tuple[dict[str, str], float]:
    """Look at a graph in which topics appear at times after the start; return what was found and after how long."""
    discovery, step = Discovery(STARTED_S), 0
    while not discovery.is_known(_heard(appearing, step * STEP_S), STARTED_S + step * STEP_S):
        step += 1
    return discovery.found, step * STEP_S


def _heard(appearing: Sequence[tuple[float, dict[str, str]]], after_s: float) -> dict[str, str]:
    return {name: kind for at_s, topics in appearing if at_s <= after_s for name, kind in topics.items()}


def test_a_graph_is_looked_at_until_drivers_whose_announcements_were_lost_are_found() -> None:
    found, took_s = look_around((0.1, NEIGHBOUR | CAMERA))
    assert (found, round(took_s, 2)) == (NEIGHBOUR | CAMERA, LOOK_MIN_S)
    assert took_s > 3.0
    late = {"/rfid": "ward_msgs/msg/TagArray"}
    found, took_s = look_around((0.1, CAMERA), (3.3, late))
    assert (found, round(took_s, 2)) == (CAMERA | late, 3.3 + SETTLED_S)
    found, took_s = look_around((0.1, NEIGHBOUR), (6.0, CAMERA))
    assert (found, round(took_s, 2)) == (NEIGHBOUR | CAMERA, 6.0 + SETTLED_S)
    assert look_around() == (NOBODY, LOOK_MAX_S)
    assert look_around((0.1, NEIGHBOUR)) == (NEIGHBOUR, LOOK_MAX_S)
    restless = [(number / 2, {f"/topic{number}": "std_msgs/msg/String"}) for number in range(100)]
    assert look_around(*restless)[1] == LOOK_MAX_S
