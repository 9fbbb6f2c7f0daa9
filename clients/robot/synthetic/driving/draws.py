"""Random drives by stratum, for learning or for judging. Deterministic by seed."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from clients.robot.synthetic.driving.drive import Drive, Mount
from clients.robot.synthetic.driving.people import NoRoomError, draw_behind, draw_people
from clients.robot.synthetic.driving.placing import Space
from clients.robot.synthetic.driving.robot_motion import (
    EASING_S,
    Manoeuvre,
    Track,
    draw_speeds,
    draw_wobble,
    drive_along,
    move_track,
)
from clients.robot.synthetic.driving.room import Ground, Opening, Panel, Room, draw_room
from clients.robot.synthetic.scenario import Environment, Person, Reader, Scenario, check_scenario
from clients.robot.synthetic.scenes import HOLES
from consensus.errors import BlockRobotError

DriveStratum = Literal[
    "straight",
    "curve",
    "turn",
    "stop",
    "to-and-fro",
    "past",
    "companions",
    "crowd",
    "ramp",
    "glass",
    "time-of-flight",
    "bed",
    "aids",
]
DRIVE_STRATA: tuple[DriveStratum, ...] = get_args(DriveStratum)
MANOEUVRES: tuple[Manoeuvre, ...] = get_args(Manoeuvre)

FRAME_RATE_DEFAULT = 5
DURATIONS_S = (8.0, 9.0, 10.0)
ATTEMPTS_COUNT, TRACK_TRIES_COUNT = 50, 40
WALL_M = 0.6  # from the robot's middle
SPARE_M = 2.5  # of a corridor, beyond the robot's way
PANEL_RAD = 0.45
MIRROR_FLOOR_SHARE = 1 / 3
PITCH_DEG, ROLL_DEG = (-2.0, 12.0), 1.0
BELIEVED_M, BELIEVED_DEG = 0.03, 1.5
EXPOSURE_MAX_S = 0.02
PIECES_COUNT = (3, 8)


def draw_drive(
    seed: int, stratum: DriveStratum, *, judging: bool, stands_s: float = 0.0, frame_rate: int = FRAME_RATE_DEFAULT
) -> Drive:
    """Return a random drive; the robot stands for `stands_s` before it.

    One for judging shares no seed, neither of its draw nor of its noise, with one for learning; only it may have furniture
    of the kinds in `JUDGED_ONLY`.
    """
    for attempt in range(ATTEMPTS_COUNT):
        rng = np.random.default_rng([int(judging), DRIVE_STRATA.index(stratum), attempt, 0xD21FE, seed])
        try:
            return _draw(rng, seed, stratum, judging=judging, stands_s=stands_s, frame_rate=frame_rate)
        except NoRoomError:
            continue
    raise BlockRobotError("CONFIGURATION_INVALID", "No drive of that stratum and seed fits into a room.")


def _draw(
    rng: np.random.Generator, seed: int, stratum: DriveStratum, *, judging: bool, stands_s: float, frame_rate: int
) -> Drive:
    duration_s = float(rng.choice(DURATIONS_S))
    knots = draw_speeds(rng, _manoeuvre(rng, stratum), duration_s)
    if stands_s > 0:
        start = (0.0, 0.0, 0.0), (stands_s, 0.0, 0.0)
        moves = ((stands_s + EASING_S + at_s, speed, turn) for at_s, speed, turn in knots)
        knots, duration_s = (*start, *moves), duration_s + stands_s
    way = drive_along(knots, duration_s)
    reach = max(math.hypot(x, z) for _, x, z, _ in way)
    wide = stratum == "crowd" or (reach < 4.0 and rng.random() < 0.5)
    room = draw_room(rng, wide=wide, long_m=reach + SPARE_M + (3.0 if stratum == "crowd" else 0.0))
    track = _placed(rng, room, way)
    if stratum == "ramp":
        room = replace(room, ground=_ground(rng, track))
    if stratum == "glass":
        room = _with_panel(rng, room, track)
    space = Space.of(room, track, duration_s)
    people = draw_people(rng, space, stratum, duration_s)
    for panel in room.panels:
        if panel.kind == "glass" and rng.random() < 0.7:
            people = (*people, draw_behind(rng, space, panel, duration_s))
    least, most = PIECES_COUNT
    space.add_furniture(rng, int(rng.integers(least, most + 1)), judging=judging)
    if len(space.pieces) < least:
        raise NoRoomError
    scenario = _scenario(rng, f"{stratum}-{seed}", people, track, duration_s, judging=judging)
    if room.ground != Ground():  # only a level floor is drawn as a mirror
        scenario = replace(scenario, environment=replace(scenario.environment, mirror_floor=0.0))
    scenario = replace(scenario, frame_rate=frame_rate)
    mount = _mount(rng, scenario.camera_height_m)
    exposure_s = float(rng.uniform(0.0, EXPOSURE_MAX_S))
    drive = Drive(stratum, judging, scenario, room, tuple(space.pieces), mount, stratum == "time-of-flight", exposure_s)
    check_scenario(scenario)
    return replace(drive, scenario=replace(scenario, digest=hashlib.sha256(repr(drive).encode()).hexdigest()))


def _manoeuvre(rng: np.random.Generator, stratum: DriveStratum) -> Manoeuvre:
    own = [manoeuvre for manoeuvre in MANOEUVRES if manoeuvre == stratum]
    if stratum == "past":
        own = ["straight"]
    elif stratum == "ramp":
        own = ["straight", "stop", "to-and-fro"]
    choices = own or list(MANOEUVRES)
    return choices[int(rng.integers(len(choices)))]


def _placed(rng: np.random.Generator, room: Room, way: Track) -> Track:
    """Return the way from a start where it keeps clear of the walls. Raises NoRoomError."""
    turns = max(abs(yaw) for *_, yaw in way) > math.pi / 3
    for _ in range(TRACK_TRIES_COUNT):
        yaw = float(rng.uniform(-math.pi, math.pi)) if turns else float(rng.choice([0.0, math.pi]) + rng.normal(0, 0.1))
        half = max(room.width_m / 2 - WALL_M, 0.0)
        x = float(rng.uniform(-half, half))
        low, high = WALL_M, room.length_m - WALL_M
        if not turns:  # most of the room lies ahead
            low, high = (low, 0.5 * high) if math.cos(yaw) > 0 else (0.5 * high, high)
        track = move_track(way, x, float(rng.uniform(low, high)), yaw)
        if room.inside(np.array([point[1:3] for point in track]), WALL_M):
            return track
    raise NoRoomError


def _ground(rng: np.random.Generator, track: Track) -> Ground:
    """Return ground with a ramp or with a threshold, which the robot passes or comes near to."""
    z = [point[2] for point in track]
    at = float(rng.uniform(min(z) - 0.3, max(z) + 1.5))
    if rng.random() < 0.5:
        high = float(rng.uniform(0.01, 0.025))
        return Ground(((at, 0.0), (at + 0.05, high), (at + 0.13, high), (at + 0.18, 0.0)))
    slope = math.tan(math.radians(float(rng.uniform(2.0, 5.0)))) * float(rng.choice([-1.0, 1.0]))
    long_m = float(rng.uniform(1.5, 4.0))
    return Ground(((at, 0.0), (at + long_m, slope * long_m)))


def _with_panel(rng: np.random.Generator, room: Room, track: Track) -> Room:
    """Return the room with a mirror on a wall that the robot sees, or with a pane of glass in it."""
    _, x, z, yaw = track[int(rng.integers(len(track)))]
    wall, at = room.wall_seen(x, z, yaw + float(rng.uniform(-PANEL_RAD, PANEL_RAD)))
    begin, end = room.extent(wall)
    width = float(rng.uniform(1.0, min(3.0, end - begin - 0.2)))
    at = min(max(at, begin + width / 2 + 0.1), end - width / 2 - 0.1)
    openings = tuple(
        opening
        for opening in room.openings
        if opening.wall != wall or abs(opening.at_m - at) > (opening.width_m + width) / 2
    )
    low, high, share = float(rng.choice([0.0, 0.4, 0.8])), float(rng.uniform(1.8, 2.2)), float(rng.uniform(0.05, 0.6))
    if rng.random() < 0.5:
        openings = (*openings, Opening(wall, at, width, high, low))
        return replace(room, openings=openings, panels=(Panel("glass", wall, at, width, (low, high), share),))
    return replace(room, openings=openings, panels=(Panel("mirror", wall, at, width, (low + 0.02, high), share),))


def _mount(rng: np.random.Generator, height_m: float) -> Mount:
    pitch, roll = math.radians(float(rng.uniform(*PITCH_DEG))), math.radians(float(rng.uniform(-ROLL_DEG, ROLL_DEG)))
    believed_m = height_m + float(rng.uniform(-BELIEVED_M, BELIEVED_M))
    believed = pitch + math.radians(float(rng.uniform(-BELIEVED_DEG, BELIEVED_DEG)))
    return Mount(pitch, roll, draw_wobble(rng), believed_m, believed)


def _scenario(
    rng: np.random.Generator,
    name: str,
    people: tuple[Person, ...],
    track: Track,
    duration_s: float,
    *,
    judging: bool,
) -> Scenario:
    mirror = float(rng.uniform(0.1, 0.6)) if rng.random() < MIRROR_FLOOR_SHARE else 0.0
    holes = float(rng.choice(HOLES)) if rng.random() < 0.7 else 0.0
    return Scenario(
        name=name,
        duration_s=duration_s,
        frame_rate=FRAME_RATE_DEFAULT,
        width=640,
        height=480,
        focal_px=525.0,
        camera_height_m=float(rng.uniform(1.0, 1.35)),
        seed=2 * int(rng.integers(2**30)) + int(judging),
        empty_frames=1,
        reader=Reader(float(rng.choice([0.3, 0.5])), 1, 2, 0.1, missed=0.3, late_s=float(rng.choice([0.0, 0.0, 2.0]))),
        people=people,
        digest="",
        environment=Environment(mirror_floor=mirror, holes=holes, camera_path=track),
    )
