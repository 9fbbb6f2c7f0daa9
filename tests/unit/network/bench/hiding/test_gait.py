"""Walks for re-identification: they cross and come near, and show only what the robot's own redactor releases."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clients.robot.synthetic.scenario import Person
from network.lab.hiding import gait
from network.lab.hiding.attacks import BLUR, CONTROL, NONE, ON_OURS, OURS
from network.lab.hiding.gait import GALLERY_WALKS, PROBES, GaitReport
from network.lab.hiding.run_scene import Stage

POPULATION = [gait.build(np.random.default_rng([1, n])) for n in range(3)]


def gap_m(walk: int) -> tuple[float, bool]:
    """How near the other comes to the owner from side to side, and whether both sides of the owner are walked on."""
    owner, other = gait._scene(POPULATION, 1, walk).scenario.people
    offs = [x - start for (_, x, _), (_, start, _) in zip(other.path, [owner.path[0]] * len(other.path), strict=True)]
    return min(abs(off) for off in offs), min(offs) < 0 < max(offs)


@pytest.mark.parametrize("place", range(len(PROBES)))
def test_the_other_walks_apart_crosses_or_comes_close(place: int) -> None:
    for first in (0, GALLERY_WALKS):
        near, crosses = gap_m(first + place)
        assert crosses == (PROBES[place] == "crossing")
        assert (near < 0.7) == (PROBES[place] != "apart")


class NobodyRecovered:
    """An attacker that recovers nothing."""

    def recover(self, view: Any, *, every: int = 1) -> Any:
        return np.zeros(view.owner.shape, dtype=bool)


def test_what_the_robot_withholds_is_in_no_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a reading the redactor releases nothing, however well the owner could be cut out."""
    monkeypatch.setattr(gait, "PROBE_S", 3.0)
    monkeypatch.setattr(Person, "reading_times_s", lambda _: [])
    report = GaitReport(1, 3)
    clips = gait._recovered(POPULATION, 1, GALLERY_WALKS, {ON_OURS: NobodyRecovered()}, report)  # type: ignore[dict-item]
    assert (clips[OURS], clips[CONTROL], report.released) == ([], [], 0)
    assert len(clips[NONE]) == len(clips[BLUR]) == 1
    assert report.frames == 18


def test_what_another_is_shown_by_in_a_released_frame_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gait, "PROBE_S", 3.0)
    scene = gait._scene(POPULATION, 1, GALLERY_WALKS)
    stage = Stage(scene)
    _, labels = stage.renderer.frame_with_truth(0)
    kept = type("Given", (), {"sequence": 0})()
    monkeypatch.setattr(gait, "KeptFrame", type(kept))
    really = gait.release

    def leaking(stage: Stage, indices: Any, see: Any) -> Any:
        really(stage, indices, see)
        return [kept]

    monkeypatch.setattr(gait, "release", leaking)
    monkeypatch.setattr(gait, "placed", lambda *_: np.where(labels > 1, np.uint16(2000), np.uint16(0)))
    report = GaitReport(1, 3)
    gait._recovered(POPULATION, 1, GALLERY_WALKS, {ON_OURS: NobodyRecovered()}, report)  # type: ignore[dict-item]
    assert (report.released, report.foreign_share) == (1, 1.0)
