"""The looped recording of `bench robot`: numbers and stamps go on, and nobody leaps where a round ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from clients.robot.sensing.sensor_events import Frame, RefusedMessage, Sighting, SourceEvent
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.render import Renderer
from consensus.records.renditions import ENCODING_PNG16, RENDITION_VERSION, Rendition
from network.bench.robot.robot_owners import OwnFrames
from network.bench.robot.robot_scene import LOOP_MAX_S, PEOPLE, LoopedSource, is_in_place, loop_seconds, make_scene

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
    source = LoopedSource(cast(BagSource, recorded or Recorded()), loop_ms=300, frames=frames)
    return list(source.events())


def test_frames_and_readings_go_on_over_the_end_of_a_round() -> None:
    frames = [event for event in looped(7) if isinstance(event, Frame)]
    assert [frame.sequence for frame in frames] == list(range(7))
    assert [frame.captured_at_ms for frame in frames] == [1_000 + 100 * number for number in range(7)]
    assert all(frame.received_at_ms == frame.captured_at_ms + 5 for frame in frames)
    first, second = (event for event in looped(6) if isinstance(event, Sighting))
    assert second == replace(first, first_seen_ms=1_310, last_seen_ms=1_320)
    assert second.received_at_ms == 1_330
    assert not any(isinstance(event, Frame) for event in looped(5, Recorded(frames=0)))


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
