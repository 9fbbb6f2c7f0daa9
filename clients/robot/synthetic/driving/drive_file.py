"""Drives written by hand: a scenario file with a room, furniture and the robot's way in it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast, get_args

import numpy as np

from clients.robot.synthetic.driving.drive import Drive, Mount
from clients.robot.synthetic.driving.furniture import KINDS, Piece, Shape, make_shape
from clients.robot.synthetic.driving.robot_motion import WOBBLE_MAX_RAD, Wobble, drive_along, move_track
from clients.robot.synthetic.driving.room import Opening, Room, Wall
from clients.robot.synthetic.scenario import (
    SHIPPED_FOLDER,
    Scenario,
    check_scenario,
    check_times,
    named_faults,
    parse_scenario,
)
from consensus.bounded_text import read_toml_text
from consensus.errors import BlockRobotError

PARTITION = "partition"
PIECES_MAX_COUNT = 31  # what a label of the truth can number

_STEADY = Wobble(pitch=((WOBBLE_MAX_RAD / 4, 1.3, 0.0),), roll=((WOBBLE_MAX_RAD / 6, 1.7, 0.5),))

DRIVE_TOPICS_FILE = SHIPPED_FOLDER / "drive-topics.toml"


def load_shipped_scene(name: str) -> Scenario | Drive:
    """Of a scenario file that comes with the robot."""
    return parse_scene((SHIPPED_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def parse_scene(text: str) -> Scenario | Drive:
    """Return a drive if the file has a `[room]`. Raises CONFIGURATION_INVALID at the first error."""
    scenario = parse_scenario(text)
    table = read_toml_text(text)
    if "room" not in table:
        return scenario
    with named_faults():
        return _drive(scenario, table)


def _drive(scenario: Scenario, table: dict[str, Any]) -> Drive:
    robot, rows = table["robot"], table.get("furniture", [])
    if len(rows) > PIECES_MAX_COUNT:
        raise BlockRobotError("CONFIGURATION_INVALID", "Scenario: there is too much furniture.")
    knots = tuple((float(t), float(speed), math.radians(float(turn))) for t, speed, turn in robot["speeds"])
    check_times("the robot", [knot[0] for knot in knots], "speeds")
    x, z, degrees = (float(part) for part in robot["start"])
    track = move_track(drive_along(knots, scenario.duration_s), x, z, math.radians(degrees))
    scenario = replace(scenario, environment=replace(scenario.environment, camera_path=track))
    check_scenario(scenario)
    pitch = math.radians(float(robot.get("pitch_deg", 0.0)))
    mount = Mount(pitch, 0.0, _STEADY, scenario.camera_height_m, pitch)
    rng = np.random.default_rng(scenario.seed)
    return Drive(scenario.name, False, scenario, _room(table["room"]), tuple(_piece(row, rng) for row in rows), mount)


def _room(table: dict[str, Any]) -> Room:
    openings = tuple(
        Opening(_wall(row), float(row["at_m"]), float(row["width_m"]), float(row.get("top_m", 2.1)))
        for row in table.get("doors", [])
    )
    width, length, ceiling = (float(table[name]) for name in ("width_m", "length_m", "ceiling_m"))
    return Room(width, length, ceiling, openings)


def _wall(row: dict[str, Any]) -> Wall:
    if row["wall"] not in get_args(Wall):
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"Scenario: wall = {row['wall']!r} is none of {', '.join(get_args(Wall))}."
        )
    return cast(Wall, row["wall"])


def _piece(row: dict[str, Any], rng: np.random.Generator) -> Piece:
    kind, heading = str(row["kind"]), math.radians(float(row.get("heading_deg", 0.0)))
    if kind == PARTITION:
        wide = float(row["width_m"])
        shape = Shape((), ((0.0, 1.75, 0.0, wide, 3.5, 0.1, 0.0),))
    elif kind in KINDS:
        shape = make_shape(kind, rng)
    else:
        raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: kind = {kind!r} is no furniture.")
    return Piece(kind, shape, float(row["x"]), float(row["z"]), heading)
