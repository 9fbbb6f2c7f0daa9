"""The `bench robot` scene: two registered people, rendered once, loopable."""

from __future__ import annotations

import math
import random
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace

from clients.robot.sensing.sensor_events import Depth, Frame, Sighting, SourceEvent
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import Clock, play_events
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
name = "bench-robot-{fps}fps-{seconds}s-seed{seed}"
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
_PLACES = (((-0.90, 2.05), (-0.95, 2.50)), ((0.85, 3.50), (1.05, 4.30)))  # (x, z) in metres, to and fro


def is_in_place(alias: str, picture: Rendition) -> bool:
    stands_left = all(x < 0 for x, _ in _PLACES[PEOPLE.index(alias)])
    shows_left = 2 * picture.x + picture.box_width < picture.width
    return stands_left == shows_left


def loop_seconds(seconds: float) -> int:
    return max(1, min(LOOP_MAX_S, math.ceil(seconds)))


def make_scene(seconds: int, fps: int, seed: int) -> Scenario:
    drawn = random.Random(seed)  # noqa: S311 - a scene, no secret
    text = _HEAD.format(seconds=seconds, fps=fps, seed=seed)
    for alias, places in zip(PEOPLE, _PLACES, strict=True):
        text += _PERSON.format(
            alias=alias,
            height=drawn.uniform(1.55, 1.90),
            girth=drawn.uniform(0.92, 1.10),
            cadence=drawn.uniform(0.9, 1.1),
            path=", ".join(f"[{at:.3f}, {x}, {z}]" for at, x, z in _to_and_fro(seconds, places)),
            first=_FIRST_S,
            last=seconds - _LAST_S,
            every=READ_EVERY_S,
        )
    return parse_scenario(text)


def _to_and_fro(
    seconds: int, places: tuple[tuple[float, float], tuple[float, float]]
) -> Iterator[tuple[float, float, float]]:
    count = 2 * max(1, round(seconds / _STEP_S / 2))
    for number in range(count + 1):
        yield (seconds * number / count, *places[number % 2])
    yield (seconds + _BEYOND_S, *places[0])


class LoopedSource:
    """A recording looped with continuing stamps and numbers."""

    def __init__(self, recording: BagSource, *, loop_ms: int, frames: int) -> None:
        """`loop_ms` is a round's length; ends with frame `frames`."""
        self._recording = recording
        self._loop_ms = loop_ms
        self._frames = frames

    @property
    def start_ms(self) -> int:
        return self._recording.start_ms

    @property
    def focal_px(self) -> float | None:
        return self._recording.focal_px

    @property
    def focal_from(self) -> str:
        return self._recording.focal_from

    def shift_to(self, start_ms: int) -> None:
        self._recording.shift_to(start_ms)

    def empty_frames(self) -> list[Depth]:
        return self._recording.empty_frames()

    def events(self) -> Iterator[SourceEvent]:
        seen, rounds = 0, 0
        while True:
            before = seen
            for event in self._recording.events():
                if isinstance(event, Frame):
                    if seen == self._frames:
                        return
                    yield self._moved_frame(event, rounds * self._loop_ms, before)
                    seen += 1
                else:
                    yield self._moved(event, rounds * self._loop_ms)
            rounds += 1
            if seen in (before, self._frames):
                return

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        return play_events(self.events(), clock)

    @staticmethod
    def _moved_frame(frame: Frame, by_ms: int, by_count: int) -> Frame:
        received = None if frame.received_at_ms is None else frame.received_at_ms + by_ms
        return replace(
            frame,
            captured_at_ms=frame.captured_at_ms + by_ms,
            sequence=frame.sequence + by_count,
            received_at_ms=received,
        )

    @staticmethod
    def _moved(event: SourceEvent, by_ms: int) -> SourceEvent:
        if not isinstance(event, Sighting):
            return event
        received = None if event.received_at_ms is None else event.received_at_ms + by_ms
        return replace(
            event,
            first_seen_ms=event.first_seen_ms + by_ms,
            last_seen_ms=event.last_seen_ms + by_ms,
            received_at_ms=received,
        )
