"""The looped recording of `bench robot`: numbers and stamps go on, and nobody leaps where a round ends."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.sensing.sensor_events import Frame, Odometry, RefusedMessage, Sighting, SourceEvent
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario_bag import drive_odometry
from consensus.records.renditions import ENCODING_PNG16, RENDITION_VERSION, Rendition
from network.bench.robot.robot_owners import OwnFrames
from network.bench.robot.robot_scene import (
    LOOP_MAX_S,
    PEOPLE,
    is_in_place,
    loop_seconds,
    looped_events,
    make_drive,
    make_scene,
)

DEPTH = np.zeros((2, 2), np.uint16)


class Recorded:
    """A recording of three frames at 10 a second, a reading and a bad message."""

    def __init__(self, shift_ms: int = 0, frames: int = 3) -> None:
        self.shift_ms = shift_ms
        self.frames = frames

    def events(self) -> Iterator[SourceEvent]:
        at = 1_000 + self.shift_ms
        yield Sighting(at + 10, at + 20, "E2", received_at_ms=at + 30)
        yield RefusedMessage(at + 31, "frame", "size")
        for number in range(self.frames):
            yield Frame(at + 100 * number, number, DEPTH, at + 100 * number + 5)


def looped(frames: int, recorded: Recorded | None = None) -> list[Any]:
    return list(looped_events((recorded or Recorded()).events, loop_ms=300, frames=frames))


def test_frames_and_readings_go_on_over_the_end_of_a_round() -> None:
    frames = [event for event in looped(7) if isinstance(event, Frame)]
    assert [frame.sequence for frame in frames] == list(range(7))
    assert [frame.captured_at_ms for frame in frames] == [1_000 + 100 * number for number in range(7)]
    assert all(frame.received_at_ms == frame.captured_at_ms + 5 for frame in frames)
    first, second = (event for event in looped(6) if isinstance(event, Sighting))
    assert second == replace(first, first_seen_ms=1_310, last_seen_ms=1_320)
    assert second.received_at_ms == 1_330
    assert not any(isinstance(event, Frame) for event in looped(5, Recorded(frames=0)))


def test_odometry_goes_on_from_where_a_round_ended_and_what_would_come_late_is_left_out() -> None:
    """Each round leads a metre ahead and a quarter turn to the left; four rounds are a square."""

    def play_round() -> Iterator[SourceEvent]:
        yield Frame(1_000, 0, DEPTH, 1_000)
        yield Odometry(1_000, 0.0, 0.0, 0.0, 1_020)
        yield Odometry(1_250, 1.0, 0.0, math.pi / 2, 1_270)
        yield Odometry(1_290, 9.0, 9.0, 9.0, 1_310)

    places = [event for event in looped_events(play_round, loop_ms=300, frames=4) if isinstance(event, Odometry)]
    assert [place.at_ms for place in places] == [1_000 + 300 * n + by for n in range(4) for by in (0, 250)]
    assert all(place.received_at_ms == place.at_ms + 20 for place in places)
    ends = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
    for number, place in enumerate(places):
        assert (place.ahead_m, place.left_m) == pytest.approx(ends[(number + 1) // 2], abs=1e-9)
        assert place.yaw == pytest.approx((number + 1) // 2 * math.pi / 2)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_that_drives_ends_where_it_began_and_no_step_of_its_odometry_is_a_jump(seed: int) -> None:
    drive, motion = make_drive(5, seed), OwnMotion()
    assert drive.scenario.camera_at(0.0) == pytest.approx(drive.scenario.camera_at(float(LOOP_MAX_S)))
    assert max(drive.scenario.camera_at(at_s)[1] for at_s in range(LOOP_MAX_S)) > 2.5
    came = sorted(drive_odometry(drive, 0), key=lambda row: row[0])

    def play_round() -> Iterator[SourceEvent]:
        yield Frame(0, 0, DEPTH, 0)
        yield from (replace(place, received_at_ms=at_ms) for at_ms, place in came)

    looped = looped_events(play_round, loop_ms=1_000 * LOOP_MAX_S, frames=3)
    places = [RobotPlace.of_camera(place, 0.0, 0.0) for place in looped if isinstance(place, Odometry)]
    for before, after in pairwise(places):
        motion.add(after)
        assert math.hypot(after.x_m - before.x_m, after.z_m - before.z_m) < 0.03
        assert abs(after.yaw - before.yaw) < math.radians(0.1)
    last_ms = 3_000 * LOOP_MAX_S - 200
    assert motion.is_continuous(last_ms - 50_000, last_ms), "two ends of a round lie between"
    for person in drive.scenario.people:
        assert person.place(0.0) == pytest.approx(person.place(float(LOOP_MAX_S)))
        for at_s in np.linspace(0, LOOP_MAX_S, 50):
            right, _, ahead = drive.scenario.seen_from_robot(person, float(at_s)) or (0.0, 0.0, 0.0)
            assert 2.0 < ahead < 4.5
            assert abs(right) / ahead < 0.3, "not near the picture's edge"
            assert (right < 0) == (person.alias == PEOPLE[0]), "each keeps to a side"


@pytest.mark.parametrize("frames", [1, 3, 6])
def test_it_ends_with_the_last_frame_that_is_wanted(frames: int) -> None:
    found = looped(frames)
    assert sum(isinstance(event, Frame) for event in found) == frames
    assert isinstance(found[-1], Frame)


def test_a_short_measurement_renders_what_it_plays_and_its_seed_draws_people_and_noise() -> None:
    assert [loop_seconds(seconds) for seconds in (0.5, 5, 5.1, 600)] == [1, 5, 6, LOOP_MAX_S]
    assert make_scene(4, 10, 1) == make_scene(4, 10, 1)
    assert make_scene(4, 10, 1).digest != make_scene(4, 10, 2).digest
    assert make_scene(4, 10, 1).people[0].height_m != make_scene(4, 10, 2).people[0].height_m


@pytest.mark.parametrize("seconds", [2, 6, LOOP_MAX_S])
def test_both_people_are_read_and_in_view_all_the_time_and_end_where_they_began(seconds: int) -> None:
    scene = make_scene(seconds, 30, seed=3)
    assert scene.tagged_aliases == PEOPLE
    assert scene.frame_count == seconds * 30
    for person in scene.people:
        assert person.place(0.0) == pytest.approx(person.place(float(seconds)))
        for at_s in np.linspace(0, seconds, 50):
            place = person.place(float(at_s))
            assert place is not None
            assert abs(place[0]) / place[1] < 0.5  # the picture's half width is 0.61 of the distance
        assert max(person.reading_times_s()) < seconds


def pictures(number: int, seed: int) -> list[Rendition]:
    """What a robot without fault shows of one person, now and then: the box of her pixels, as the renderer knows it."""
    scene = make_scene(4, 10, seed)
    renderer, found = Renderer(scene), []
    for sequence in range(0, scene.frame_count, 7):
        rows, columns = np.nonzero(renderer.truth(sequence).labels == number + 1)
        box = (int(columns.min()), int(rows.min()), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)
        found.append(
            Rendition(
                version=RENDITION_VERSION,
                captured_at_ms=1,
                sequence=sequence,
                width=scene.width,
                height=scene.height,
                x=box[0],
                y=box[1],
                box_width=box[2],
                box_height=box[3],
                background_id=bytes(32),
                encoding=ENCODING_PNG16,
                pixels=b"",
            )
        )
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_two_owners_who_are_exchanged_altogether_are_noticed(seed: int) -> None:
    """Each finds as many frames as the robot kept for one tag; that they show the other one, the scene knows."""
    shown = [pictures(number, seed) for number in range(len(PEOPLE))]
    for order, misplaced in (((0, 1), 0), ((1, 0), len(shown[0]))):
        for alias, place in zip(PEOPLE, order, strict=True):
            found = OwnFrames()
            for picture in shown[place]:
                found.note(b"robot", picture, is_theirs=is_in_place(alias, picture))
            assert found.frames[b"robot"].total() == len(shown[0]) > 3
            assert found.misplaced_frames == misplaced
