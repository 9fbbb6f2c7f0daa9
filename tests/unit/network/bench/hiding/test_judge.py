"""The judge end to end on a few scenes, and its sums on scores that were made by hand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from network.bench.hiding.attacks import (
    CONTROL,
    NONE,
    ON_OURS,
    ON_RAW,
    OURS,
    FrameScore,
    SceneReport,
    judge_scene,
    learn_from,
)
from network.bench.hiding.figures import summarise
from network.bench.hiding.gait import GaitReport
from network.bench.hiding.learned import LearnedAttacker, train
from network.bench.hiding.play import Played, Stage, gap_px, owner_cut
from network.bench.hiding.scenes import JUDGING, LEARNING, draw_scenes


def report(number: int, stratum: str, ours: float, control: float, *, wrong: int = 0) -> SceneReport:
    played = Played(covered=10, visible=10, withheld=Counter(ambiguous=2), kept=8, wrong=wrong)
    frame = FrameScore(released=True, gap_px=20.0, owner_kept=0.98, foreign_px=0)
    frame.ious = {(OURS, ON_OURS): ours, (CONTROL, ON_OURS): control, (NONE, ON_RAW): 0.9}
    frame.ious |= {(OURS, ON_RAW): 0.0, (CONTROL, ON_RAW): 0.0}
    return SceneReport(1, number, stratum, played, [frame], [4.0], [5.0])


GAIT = GaitReport(1, 4, right={OURS: 2.0, NONE: 7.0}, clips={OURS: 8, NONE: 8})


def test_no_gain_over_the_control_meets_the_goals() -> None:
    figures = summarise([report(n, "apart", 0.2, 0.2) for n in range(20)], [GAIT], seed=1)
    assert figures["difference_upper95"] == 0.0
    assert (figures["reid_rate"], figures["chance_rate"]) == (0.25, 0.25)
    assert figures["withheld_rate"] == 0.2
    assert all(figures["goals"].values())


def test_a_leak_in_one_stratum_shows_there_and_in_sum() -> None:
    clean = [report(n, "apart", 0.2, 0.2) for n in range(10)]
    leaking = [report(n, "touching", 0.5, 0.2, wrong=1) for n in range(10, 20)]
    figures = summarise([*clean, *leaking], [GAIT], seed=1)
    assert figures["strata"]["apart"]["difference_upper95"] == 0.0
    assert figures["strata"]["touching"]["difference"] == pytest.approx(0.3)
    assert figures["difference_upper95"] > 0.15
    assert figures["wrong_owner_rate"] == pytest.approx(10 / 160)
    assert not figures["goals"]["difference_upper95 <= 0.02"]
    assert not figures["goals"]["wrong_owner_rate == 0"]


def test_a_goal_that_was_not_measured_is_not_met() -> None:
    figures = summarise([], [], seed=1)
    assert not any(met for goal, met in figures["goals"].items() if "wrong" not in goal)


def test_no_scene_to_learn_from_is_judged() -> None:
    learning, judging = (draw_scenes(1, 14, purpose) for purpose in (LEARNING, JUDGING))
    assert not {s.scenario.seed for s in learning} & {s.scenario.seed for s in judging}
    assert draw_scenes(1, 14, JUDGING) == judging
    assert len({scene.stratum for scene in judging}) == 7


def test_the_gap_is_in_whole_pixels() -> None:
    owner, other = np.zeros((10, 20), dtype=bool), np.zeros((10, 20), dtype=bool)
    owner[:, 2], other[:, 7] = True, True
    assert gap_px(owner, other) == pytest.approx(10, abs=0.5)
    assert gap_px(owner, np.zeros_like(owner)) == float("inf")


@pytest.fixture(scope="module")
def attackers() -> dict[str, LearnedAttacker]:
    examples = [learn_from(scene) for scene in draw_scenes(1, 2, LEARNING, duration_s=3.0)]
    raw = [one for some in examples for one in some.raw]
    ours = [one for some in examples for one in some.ours]
    return {ON_RAW: train(raw, seed=1, trees=8), ON_OURS: train(ours or raw, seed=1, trees=8)}


def test_a_scene_is_played_attacked_and_scored_the_same_each_time(attackers: dict[str, LearnedAttacker]) -> None:
    scene = draw_scenes(1, 1, JUDGING, duration_s=4.0)[0]
    first, second = judge_scene(scene, attackers), judge_scene(scene, attackers)
    assert [frame.ious for frame in first.frames] == [frame.ious for frame in second.frames]
    assert first.played == second.played
    assert first.played.kept + sum(first.played.withheld.values()) >= first.played.visible
    assert first.played.wrong == 0


def test_the_control_shows_the_same_owner_in_the_same_place() -> None:
    scene = draw_scenes(1, 1, JUDGING)[0]
    stage, index = Stage(scene), 20
    depth, labels = stage.renderer.frame_with_truth(index)
    alone, alone_labels = stage.control("owner").frame_with_truth(index)
    label = scene.owners["owner"]
    assert set(np.unique(alone_labels)) <= {0, label}
    kept = owner_cut(stage, alone, alone_labels, label, troubled=True)
    assert kept is not None
    assert np.count_nonzero((labels == label) & (alone_labels == label)) > 0.9 * np.count_nonzero(labels == label)
    assert depth.shape == alone.shape
