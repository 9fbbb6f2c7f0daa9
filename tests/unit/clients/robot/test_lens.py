"""The focal length of a live camera comes when the camera comes: it is waited for, used from then on, and told."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from clients.robot.cli.run_report import summary_lines
from clients.robot.hiding import standing_hider
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX, FOCAL_WAIT_MAX_S, CameraFigures, CameraIntrinsics
from clients.robot.sensing.sensor_events import Frame, Sighting, SourceEvent
from clients.robot.sources.messages.topics import Topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import Source
from tests.unit.clients.robot.run_summaries import FRAMES, summary_of
from tests.unit.clients.robot.test_days_end import a_day
from tests.virtual_time import run_virtual, virtual_now_ms

FOCAL_PX = 131.0


def frame(number: int) -> Frame:
    return Frame(number, number, np.ones((4, 6), np.uint16))


class Camera(BagSource):
    """A recording whose focal length is known only so long after the test began."""

    known_after_ms = 0
    began_ms = 0

    @property
    def focal_px(self) -> float | None:
        return FOCAL_PX if virtual_now_ms() - self.began_ms >= self.known_after_ms else None


async def story(
    bag: Path, known_after_s: float, frames: int, *, live: bool = True
) -> tuple[list[float], list[int], CameraIntrinsics]:
    """Return what was used, when each event went on (ms), and the lens; a reading comes first, frames every second."""
    used: list[float] = []
    camera = Camera(bag)
    camera.began_ms, camera.known_after_ms = virtual_now_ms(), round(known_after_s * 1000)
    lens = CameraIntrinsics(camera, used.append, live=live)

    async def events() -> AsyncIterator[SourceEvent]:
        yield Sighting(1, 2, "E1")
        for number in range(frames):
            yield frame(number)
            await asyncio.sleep(1)

    went = [virtual_now_ms() - camera.began_ms async for _ in lens.learnt(events())]
    return used, went, lens


def test_a_focal_length_counts_from_when_it_is_known_and_only_the_first_frame_waits(small_bag: Path) -> None:
    used, went, lens = run_virtual(story(small_bag, 0, 3))
    assert (used, went) == ([FOCAL_PX], [0, 0, 1_000, 2_000])
    assert lens.summarise() == CameraFigures(focal_px=FOCAL_PX, focal_from="camera-info", frames_before=0)
    used, went, lens = run_virtual(story(small_bag, 1.5, 2))
    assert (used, went[0]) == ([FOCAL_PX], 0)
    assert 1_500 <= went[1] < 1_600
    assert lens.summarise().frames_before == 0
    used, went, lens = run_virtual(story(small_bag, 4.5, 5))
    assert used == [FOCAL_PX]
    assert went[1] == pytest.approx(FOCAL_WAIT_MAX_S * 1000, abs=60)
    assert lens.summarise() == CameraFigures(focal_px=FOCAL_PX, focal_from="camera-info", frames_before=3)
    used, _, lens = run_virtual(story(small_bag, 3_600, 4))
    assert used == []
    assert lens.summarise() == CameraFigures(focal_px=FOCAL_DEFAULT_PX, focal_from="assumed", frames_before=4)
    _, went, _ = run_virtual(story(small_bag, 3_600, 2, live=False))
    assert went == [0, 0, 1_000]


@pytest.mark.parametrize(("told", "origin"), [(None, "camera-info"), (500.0, "topics")])
def test_a_source_says_where_its_focal_length_is_from(small_bag: Path, told: float | None, origin: str) -> None:
    source: Source = BagSource(small_bag, topics=Topics(focal_px=told))
    assert source.focal_from == origin


@pytest.mark.usefixtures("inline_threads")
def test_a_run_tells_its_focal_length_and_where_it_is_from(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BagSource, "focal_px", FOCAL_PX)
    measured_by: list[float] = []
    segment = standing_hider.segment
    monkeypatch.setattr(standing_hider, "segment", lambda *given: [measured_by.append(given[2]), segment(*given)][1])

    async def told(day: Any) -> None:
        summary = await day.ends_with("", frames=6)
        assert set(measured_by) == {FOCAL_PX}
        assert summary.camera == CameraFigures(focal_px=FOCAL_PX, focal_from="camera-info", frames_before=0)

    a_day(tmp_path, small_bag, monkeypatch, told)


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        (CameraFigures(focal_px=525.0, focal_from="assumed", frames_before=9), "525 pixels were assumed"),
        (CameraFigures(focal_px=131.0, focal_from="camera-info", frames_before=9), "before that 9 frames"),
        (CameraFigures(focal_px=131.0, focal_from="camera-info", frames_before=0), ""),
    ],
)
def test_a_guess_is_said_at_the_end(camera: CameraFigures, told: str) -> None:
    said = [line for line in summary_lines(replace(summary_of(FRAMES), camera=camera)) if "focal" in line]
    assert (told in said[0]) if told else said == []
