"""The companions' judge counts what it should, and the training exports what was learned, the same each time."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from clients.robot.hiding.companion import CUES, trees_of
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.synthetic.scenes import draw_scene
from network.lab.hiding import companion_training as training
from network.lab.hiding import companions
from network.lab.hiding.companions import SEED_STRIDE, Observed, goals_met, observe, rates


def seen(share: float, withhold_reason: str = "", person: int = 1) -> Observed:
    return Observed(0, person, share, withhold_reason, np.zeros(len(CUES)))


def test_a_pairs_silhouettes_hold_the_pair_and_a_single_persons_do_not() -> None:
    (pair,) = list(observe(draw_scene(3, "companion", manner="embrace", child=False, third=False), [40]))
    assert pair.second_share > 0.06
    (single,) = list(observe(draw_scene(3, "single"), [40]))
    assert single.second_share == 0
    assert len(single.cues) == len(CUES)


def test_pairs_are_found_where_merged_and_shown_where_nothing_is_said() -> None:
    looks = [("embrace", 1, [seen(0.4, "merged"), seen(0.4, "contact"), seen(0.3), seen(0.0)])]
    figures = rates("embrace", looks, pairs=True)
    assert (figures["frames"], figures["tracks"]) == (3, 1)
    assert figures["merged_frames"] == pytest.approx(1 / 3, abs=1e-3)
    assert figures["shown_share"] == pytest.approx(1 / 3, abs=1e-3)
    assert figures["split_share"] == 0.25


def test_companions_that_are_shown_are_counted_and_single_people_by_track() -> None:
    figures = rates("embrace", [("embrace", 1, [seen(0.02), seen(0.3), seen(0.4, "merged"), seen(0.01)])], pairs=True)
    assert (figures["frames"], figures["faint_shown"], figures["split_share"]) == (3, 1, 0.25)
    assert figures["shown_share"] == pytest.approx(2 / 3, abs=1e-3)
    looks = [("single", 1, [seen(0.0), seen(0.0, "merged", 2)]), ("stick", 2, [seen(0.0, "merged")])]
    figures = rates("single", looks, pairs=False)
    assert (figures["frames"], figures["tracks"]) == (2, 2)
    assert (figures["merged_frames"], figures["withheld_frames"]) == (0.5, 0.5)
    assert rates("bed", looks, pairs=False)["merged_frames"] is None


def test_what_is_judged_is_what_the_watch_says_not_a_frame_by_itself() -> None:
    """A pool that began with a suspicion stays suspected for a while, though the frames look like one person."""

    class Suspecting(CompanionWatch):
        def step(self, silhouettes: tuple[Silhouette, ...], at_ms: int) -> tuple[Silhouette, ...]:
            first = tuple(replace(one, companion_odds=8.0) for one in silhouettes) if at_ms == 4_000 else silhouettes
            return super().step(first, at_ms)

    scenario = draw_scene(3, "single")
    alone = [one.withhold_reason for one in observe(scenario, [40, 41])]
    assert alone == ["", ""]
    assert [one.withhold_reason for one in observe(scenario, [40, 41], CompanionWatch())] == alone
    assert [one.withhold_reason for one in observe(scenario, [40, 41], Suspecting())] == ["merged", "merged"]


def test_the_command_judges_the_watch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every silhouette of a scene goes through one watch, in time order."""
    times: list[int] = []
    really = CompanionWatch.step

    def noting(self: CompanionWatch, seen: tuple[Silhouette, ...], at_ms: int) -> tuple[Silhouette, ...]:
        times.append(at_ms)
        return really(self, seen, at_ms)

    monkeypatch.setattr(CompanionWatch, "step", noting)
    companions._look(("single", "single", None, None, SEED_STRIDE))
    assert len(times) == companions.TRACK_FRAMES_COUNT
    assert times == sorted(times)


def test_goals_are_met_only_where_every_kind_meets_them() -> None:
    found = {name: {"merged_frames": 0.95} for name in ("arm in arm", "embrace", "pushing")}
    alone = {
        "single": {"merged_frames": 0.01},
        "wheelchair": {"merged_frames": 0.02},
        "rollator": {"merged_frames": 0.05},
    }
    assert all(goals_met(found, alone).values())
    assert not goals_met({**found, "pushing": {"merged_frames": None}}, alone)["companions_found"]
    assert not goals_met(found, {**alone, "single": {"merged_frames": 0.02}})["single_false_alarms"]


def test_training_exports_what_was_learned_and_the_same_each_time() -> None:
    rng = np.random.default_rng(5)
    cues = rng.normal(size=(240, len(CUES))).round(6)
    labels = cues[:, 0] + 0.5 * cues[:, 7] > 0.3
    place = np.zeros(120, np.int64)
    one, two = (training.train((place, labels[:120], cues[:120]), (place, labels[120:], cues[120:])) for _ in range(2))
    assert msgspec.json.encode(one) == msgspec.json.encode(two)
    table = training.with_thresholds(one, np.ones(240, np.int64), labels, cues)
    trees = trees_of(table)
    odds = np.array([trees.log_odds(row) for row in cues])
    assert np.mean((odds > 0) == labels) > 0.97
    assert np.mean(odds[~labels] > trees.suspect) <= 0.05
    assert trees.certain >= trees.suspect


def test_training_never_draws_what_is_judged() -> None:
    assert training.THRESHOLD_SEED + training.SCENES_DEFAULT_COUNT < SEED_STRIDE
    assert training.TRAINING_SEED + training.SCENES_DEFAULT_COUNT <= training.THRESHOLD_SEED
    with pytest.raises(SystemExit):
        training.main(["--out", "unused.json", "--scenes", "900000"])
