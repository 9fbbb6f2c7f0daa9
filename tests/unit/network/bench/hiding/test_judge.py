"""The judge end to end on a few scenes, and its sums on scores that were made by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.cutouts import Cutout, encode_cutout
from clients.robot.hiding.frame_redactor import KeptFrame
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Tracker
from clients.robot.sensing.sensor_events import Frame
from network.lab.hiding import run_scene as play_module
from network.lab.hiding.attacks import (
    CONTROL,
    CONTROL_NOT_CUT,
    NONE,
    ON_OURS,
    ON_RAW,
    OURS,
    FrameScore,
    SceneReport,
    judge_scene,
    learn_from,
)
from network.lab.hiding.evaluate import holds
from network.lab.hiding.figures import summarise
from network.lab.hiding.gait import GaitReport
from network.lab.hiding.learned import LearnedAttacker, train
from network.lab.hiding.run_scene import Played, Stage, Timed, gap_px, owner_cutout
from network.lab.hiding.scenes import JUDGING, LEARNING, draw_scenes


def report(number: int, stratum: str, ours: float, control: float, *, wrong: int = 0) -> SceneReport:
    played = Played(covered=10, visible=10, withheld=Counter(ambiguous=2), kept=8, wrong=wrong)
    frame = FrameScore(released=True, gap_px=20.0, owner_kept=0.98, foreign_px=0)
    frame.ious = {(OURS, ON_OURS): ours, (CONTROL, ON_OURS): control, (NONE, ON_RAW): 0.9}
    frame.ious |= {(OURS, ON_RAW): 0.0, (CONTROL, ON_RAW): 0.0}
    return SceneReport(1, number, stratum, played, [frame], [4.0], [5.0])


GAIT = GaitReport(1, 4, right={OURS: 2.0, NONE: 7.0}, clips={OURS: 8, NONE: 8})


def test_no_gain_over_the_control_meets_the_goals() -> None:
    figures = summarise([report(n, "apart", 0.2, 0.2) for n in range(20)], [GAIT], seed=1)
    assert figures.difference_upper95 == 0.0
    assert (figures.reid_rate, figures.chance_rate) == (0.25, 0.25)
    assert figures.withheld_rate == 0.2
    assert all(figures.goals.values())


def test_a_leak_in_one_stratum_shows_there_and_in_sum() -> None:
    clean = [report(n, "apart", 0.2, 0.2) for n in range(10)]
    leaking = [report(n, "touching", 0.5, 0.2, wrong=1) for n in range(10, 20)]
    figures = summarise([*clean, *leaking], [GAIT], seed=1)
    assert figures.strata["apart"].difference_upper95 == 0.0
    assert figures.strata["touching"].difference == pytest.approx(0.3)
    assert figures.difference_upper95 > 0.15
    assert figures.wrong_owner_rate == pytest.approx(10 / 160)
    assert not figures.goals["difference_upper95 <= 0.02"]
    assert not figures.goals["wrong_owner_rate == 0"]


def test_a_goal_that_was_not_measured_is_not_met() -> None:
    figures = summarise([], [], seed=1)
    assert not any(figures.goals.values())


def test_one_rendition_that_shows_the_other_misses_a_goal_however_many_are_clean() -> None:
    """What no attacker that leaves the owner's surroundings out would find: the other is inside the owner's cut."""
    reports = [report(n, "apart", 0.2, 0.2) for n in range(20)]
    reports[7].played.foreign_px, reports[7].played.foreign_share = 18_000, 0.9
    figures = summarise(reports, [GAIT], seed=1)
    assert (figures.foreign_px_max, figures.foreign_share_max) == (18_000, 0.9)
    assert [goal for goal, met in figures.goals.items() if not met] == ["foreign_share_max <= 0.001"]


def test_frames_and_scenes_that_could_not_be_attacked_are_counted() -> None:
    some, none = report(0, "apart", 0.2, 0.2), report(1, "apart", 0.2, 0.2)
    none.frames = []
    some.unattacked, none.unattacked = Counter({CONTROL_NOT_CUT: 1}), Counter({CONTROL_NOT_CUT: 3})
    figures = summarise([some, none], [GAIT], seed=1)
    assert figures.frames_not_attacked == {CONTROL_NOT_CUT: 4}
    assert figures.scenes_not_attacked == 1


def test_the_judge_holds_only_where_every_goal_and_every_part_does() -> None:
    good = summarise([report(n, "apart", 0.2, 0.2) for n in range(20)], [GAIT], seed=1)
    assert holds(good)
    assert holds(replace(good, matcher={"ok": True}, companions={"ok": True}))
    assert not holds(replace(good, matcher={"ok": True}, companions={"ok": False}))
    for goal in good.goals:
        assert not holds(replace(good, goals={**good.goals, goal: False}))


@pytest.mark.parametrize("shows", ["owner", "both", "other"])
def test_every_released_rendition_is_held_against_the_truth(monkeypatch: pytest.MonkeyPatch, shows: str) -> None:
    """A redactor that releases the other's pixels, in a scene where the true cut would be clean."""
    scene = draw_scenes(1, 1, JUDGING)[0]
    stage, label, index = Stage(scene), scene.owners["owner"], 20
    depth, labels = stage.renderer.frame_with_truth(index)
    mask = {"owner": labels == label, "both": labels > 0, "other": (labels > 0) & (labels != label)}[shows]
    released = encode_cutout(Cutout(0, 0, np.where(mask, depth, np.uint16(0))))

    class Leaking:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def push_sighting(self, *_: object) -> list[object]:
            return []

        def push_frame(self, frame: Frame) -> list[object]:
            return (
                [KeptFrame(frame.sequence, frame.captured_at_ms, "owner", released)] if frame.sequence == index else []
            )

        def flush(self) -> list[object]:
            return []

    monkeypatch.setattr(play_module, "FrameRedactor", Leaking)
    monkeypatch.setattr(Stage, "frame_indices", lambda _: range(index, index + 1))
    played = play_module.play(stage)
    others_px = int(np.count_nonzero((labels > 0) & (labels != label) & (depth > 0)))
    assert played.foreign_px == (0 if shows == "owner" else others_px)
    assert (played.foreign_share > 0.9) == (shows != "owner")
    assert played.wrong == (shows != "owner")  # the other stands nearer in this scene: most pixels of both are theirs


def test_the_time_of_a_frame_holds_all_that_a_robot_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(draw_scenes(1, 1, JUDGING)[0])
    run: list[str] = []
    for owner, name in ((CompanionWatch, "step"), (Tracker, "step"), (Matcher, "add_track"), (Matcher, "advance")):
        monkeypatch.setattr(owner, name, _noting(run, f"{owner.__name__}.{name}", getattr(owner, name)))
    monkeypatch.setattr(play_module, "extract_cutout", _noting(run, "extract_cutout", play_module.extract_cutout))
    timed = Timed(stage)
    for index in (60, 66, 72):
        timed.step(stage.renderer.frame_with_truth(index)[0], stage.at_ms(index))
    assert set(run) == {"CompanionWatch.step", "Tracker.step", "Matcher.add_track", "Matcher.advance", "extract_cutout"}
    timed.step(stage.empty[0], stage.at_ms(78))
    assert len(timed.cpu_ms) == len(timed.wall_ms) == 3  # a frame with nobody in it is not noted


def _noting(run: list[str], name: str, really: Callable[..., Any]) -> Callable[..., Any]:
    def noted(*arguments: Any) -> Any:
        run.append(name)
        return really(*arguments)

    return noted


def test_a_released_walk_that_shows_the_other_misses_a_goal() -> None:
    walks = GaitReport(1, 4, right={OURS: 2.0}, clips={OURS: 8}, frames=72, released=36, foreign_share=0.95)
    figures = summarise([report(n, "apart", 0.2, 0.2) for n in range(20)], [walks], seed=1)
    assert (figures.reid_released_rate, figures.reid_foreign_share_max) == (0.5, 0.95)
    assert [goal for goal, met in figures.goals.items() if not met] == ["reid_foreign_share_max <= 0.001"]


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
    kept = owner_cutout(stage, alone, alone_labels, label, troubled=True)
    assert kept is not None
    assert np.count_nonzero((labels == label) & (alone_labels == label)) > 0.9 * np.count_nonzero(labels == label)
    assert depth.shape == alone.shape
