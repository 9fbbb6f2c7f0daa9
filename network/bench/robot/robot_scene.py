"""The `bench robot` scenes: two registered people before a robot that stands or drives, rendered once, loopable."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from clients.robot.sensing.sensor_events import Frame, Odometry, SourceEvent
from clients.robot.sources.messages.topics import Topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import happened_ms
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_file import parse_scene
from clients.robot.synthetic.driving.robot_motion import drive_along
from clients.robot.synthetic.scenario import Scenario, parse_scenario
from consensus.records.renditions import Rendition

LOOP_MAX_S = 20
PEOPLE = ("subject-a", "subject-b")
READ_EVERY_S = 0.4
_STEP_S = 1.25
_FIRST_S = 0.1
_LAST_S = 0.4  # before the end: a reading that comes late still comes within its round
_BEYOND_S = 1.0  # paths go on, so that nobody is gone in the last frame
_HEAD = """
name = "{name}-{fps}fps-{seconds}s-seed{seed}"
duration_s = {seconds}.0
frame_rate = {fps}
width = 640
height = 480
focal_px = 525.0
camera_height_m = 1.2
seed = {seed}
empty_frames = 45

[reader]
distance_sigma_m = 0.30
antenna_front = 1
antenna_back = 2
front_misread = 0.05
missed = 0.05
late_s = 0.2
"""
_PERSON = """
[[people]]
alias = "{alias}"
height_m = {height:.2f}
girth = {girth:.2f}
cadence = {cadence:.2f}
path = [{path}]
readings_s = [{first:.2f}, {last:.2f}]
also_every_s = {every}
"""
_Places = tuple[tuple[tuple[float, float], tuple[float, float]], ...]
_PLACES: _Places = (((-0.90, 2.05), (-0.95, 2.50)), ((0.85, 3.50), (1.05, 4.30)))  # (x, z) in metres, to and fro
_PLACES_DRIVING: _Places = (((-0.65, 2.30), (-0.75, 2.80)), ((0.70, 3.30), (0.85, 4.10)))  # not near the picture's edge
_SPEEDS = (
    *((0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (7.2, 0.5, 0.0), (10.0, 0.5, 0.0), (11.2, 0.0, 0.0)),
    *((12.0, 0.0, 0.0), (13.2, -0.5, 0.0), (16.0, -0.5, 0.0), (17.2, 0.0, 0.0)),
)
"""(t, metres a second, degrees a second): as far back as it drove ahead."""
_ROOM = """
[room]
width_m = 3.8
length_m = 12.0
ceiling_m = 2.7
doors = [{{ wall = "left", at_m = 8.0, width_m = 1.4 }}]

[robot]
pitch_deg = 6.0
start = [0.0, {start}, 0.0]
speeds = {speeds}

[[furniture]]
kind = "cupboard"
x = 1.6
z = 8.0
heading_deg = 90.0
"""
_START_Z_M = 1.0
_STAMPS = ("captured_at_ms", "first_seen_ms", "last_seen_ms", "at_ms", "received_at_ms")


def is_in_place(alias: str, picture: Rendition) -> bool:
    stands_left = all(x < 0 for x, _ in _PLACES[PEOPLE.index(alias)])
    shows_left = 2 * picture.x + picture.box_width < picture.width
    return stands_left == shows_left


def loop_seconds(seconds: float) -> int:
    return max(1, min(LOOP_MAX_S, math.ceil(seconds)))


def make_scene(seconds: int, fps: int, seed: int) -> Scenario:
    return parse_scenario(_draw(seconds, fps, seed, "bench-robot", _PLACES, lambda _: 0.0))


def make_drive(fps: int, seed: int) -> Drive:
    """Return a round of a robot that drives to and fro, while both people walk with it; it stands for the first seconds."""
    times, _, ahead, _ = np.array(drive_along(_SPEEDS, float(LOOP_MAX_S))).T

    def robot_z_m(at_s: float) -> float:
        return _START_Z_M + float(np.interp(at_s, times, ahead))

    text = _draw(LOOP_MAX_S, fps, seed, "bench-robot-drive", _PLACES_DRIVING, robot_z_m)
    drive = parse_scene(text + _ROOM.format(start=_START_Z_M, speeds=[list(knot) for knot in _SPEEDS]))
    assert isinstance(drive, Drive)
    return drive


def _draw(seconds: int, fps: int, seed: int, name: str, people: _Places, robot_z_m: Callable[[float], float]) -> str:
    drawn = random.Random(seed)  # noqa: S311 - a scene, no secret
    text = _HEAD.format(name=name, seconds=seconds, fps=fps, seed=seed)
    for alias, places in zip(PEOPLE, people, strict=True):
        path = [(at_s, x, round(z + robot_z_m(at_s), 3)) for at_s, x, z in _to_and_fro(seconds, places)]
        text += _PERSON.format(
            alias=alias,
            height=drawn.uniform(1.55, 1.90),
            girth=drawn.uniform(0.92, 1.10),
            cadence=drawn.uniform(0.9, 1.1),
            path=", ".join(f"[{at_s:.3f}, {x}, {z}]" for at_s, x, z in path),
            first=_FIRST_S,
            last=seconds - _LAST_S,
            every=READ_EVERY_S,
        )
    return text


def _to_and_fro(
    seconds: int, places: tuple[tuple[float, float], tuple[float, float]]
) -> Iterator[tuple[float, float, float]]:
    count = 2 * max(1, round(seconds / _STEP_S / 2))
    for number in range(count + 1):
        yield (seconds * number / count, *places[number % 2])
    yield (seconds + _BEYOND_S, *places[0])


class LoopedSource(BagSource):
    """A recording that is played round by round."""

    def __init__(self, path: Path, topics: Topics | None, *, loop_ms: int, frames: int) -> None:
        super().__init__(path, topics=topics)
        self._loop_ms = loop_ms
        self._frames = frames

    def events(self) -> Iterator[SourceEvent]:
        return looped_events(super().events, loop_ms=self._loop_ms, frames=self._frames)


def looped_events(
    play_round: Callable[[], Iterator[SourceEvent]], *, loop_ms: int, frames: int
) -> Iterator[SourceEvent]:
    """Yield rounds of `loop_ms` up to frame `frames`: stamps and numbers go on, odometry from where a round ended.

    What comes only after its round is left out.
    """
    seen, by_ms, ends_ms = 0, 0, None
    start = place = Odometry(0, 0.0, 0.0, 0.0)
    while True:
        before = seen
        for event in play_round():
            ends_ms = happened_ms(event) + loop_ms if ends_ms is None else ends_ms
            if isinstance(event, Frame):
                if seen == frames:
                    return
                yield _later(replace(event, sequence=event.sequence + before), by_ms)
                seen += 1
            elif happened_ms(event) < ends_ms:
                place = _onwards(start, event) if isinstance(event, Odometry) else place
                yield _later(place if isinstance(event, Odometry) else event, by_ms)
        by_ms, start = by_ms + loop_ms, place
        if seen in (before, frames):
            return


def _onwards(start: Odometry, place: Odometry) -> Odometry:
    """Return where a robot is that went on from `start` by the way that leads to `place`."""
    cos, sin = math.cos(start.yaw), math.sin(start.yaw)
    ahead_m = start.ahead_m + cos * place.ahead_m - sin * place.left_m
    left_m = start.left_m + sin * place.ahead_m + cos * place.left_m
    return replace(place, ahead_m=ahead_m, left_m=left_m, yaw=start.yaw + place.yaw)


def _later(event: SourceEvent, by_ms: int) -> SourceEvent:
    stamps = {name: getattr(event, name, None) for name in _STAMPS}
    return replace(event, **{name: at_ms + by_ms for name, at_ms in stamps.items() if at_ms is not None})
