"""Cues of a companion: what they measure, how trees judge them, and how suspicion is pooled over a track."""

from __future__ import annotations

import json
import math
from importlib import resources
from typing import Any

import msgspec
import numpy as np
import pytest

from clients.robot.hiding.companion import CUES, Table, measure, shipped_model, trees_of
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.sensing.sensor_events import Depth, Mask

SHAPE = (240, 320)
FOCAL_PX = 262.5
STUMP_SUSPECT = 0.0
STUMP: dict[str, Any] = {
    "cues": list(CUES),
    "depth": 1,
    "first": -0.5,
    "suspect": STUMP_SUSPECT,
    "certain": 3.0,
    "feature": [[CUES.index("area_m2"), 0, 0], [CUES.index("saddle_m"), 0, 0]],
    "threshold": [[0.6, 0, 0], [0.1, 0, 0]],
    "left": [[1, 1, 2], [1, 1, 2]],
    "right": [[2, 1, 2], [2, 1, 2]],
    "value": [[0, -1.0, 2.0], [0, -0.5, 1.0]],
}


def cues_of(mask: Mask, depth_mm: Depth | int = 3_000, left: int = 100, top: int = 60) -> dict[str, float]:
    depth = np.broadcast_to(np.asarray(depth_mm, dtype=np.uint16), mask.shape)
    found = measure(mask, np.ascontiguousarray(depth), left, top, SHAPE, FOCAL_PX)
    assert len(found) == len(CUES)
    assert np.all(np.isfinite(found))
    return dict(zip(CUES, found.tolist(), strict=True))


def block(height: int, width: int) -> Mask:
    return np.ones((height, width), dtype=bool)


def test_a_flat_block_is_as_large_as_it_is() -> None:
    cues = cues_of(block(140, 44))
    assert cues["height_m"] == pytest.approx(1.6)
    assert cues["width_m"] == pytest.approx(44 * 3 / FOCAL_PX)
    assert cues["area_m2"] == pytest.approx(1.6 * 44 * 3 / FOCAL_PX, rel=0.02)
    assert cues["width_3_m"] == pytest.approx(cues["width_m"], rel=0.05)
    assert (cues["saddle_m"], cues["spread_m"], cues["halves_m"]) == (0, 0, 0)
    assert cues["runs_3"] == pytest.approx(1)


def test_two_heads_have_a_saddle_between_them_and_one_head_has_none() -> None:
    heads = block(140, 60)
    heads[:25, 22:38] = False
    heads[:8, 38:] = False
    two = cues_of(heads)
    assert two["saddle_m"] == pytest.approx(17 * 3 / FOCAL_PX, abs=0.03)
    assert two["second_head_lower_m"] == pytest.approx(8 * 3 / FOCAL_PX, abs=0.03)
    assert two["head_distance_m"] > 0.1
    heads[:25, 22:] = False
    assert cues_of(heads)["saddle_m"] == 0


def test_who_stands_half_behind_spreads_the_depth_and_the_view_from_above() -> None:
    flat = cues_of(block(140, 50))
    depth = np.full((140, 50), 3_000, np.uint16)
    depth[:, 25:] = 3_300
    deep = cues_of(block(140, 50), depth)
    assert deep["spread_m"] == pytest.approx(0.3)
    assert deep["halves_m"] == pytest.approx(0.3, abs=0.08)
    assert deep["footprint_m2"] >= flat["footprint_m2"]
    assert deep["plan_long_m"] > flat["plan_long_m"]


def test_a_silhouette_that_the_picture_cuts_off_says_so() -> None:
    assert cues_of(block(140, 40))["cut_below"] == 0
    assert cues_of(block(140, 40), top=100)["cut_below"] == 1
    assert cues_of(block(140, 40), left=0)["cut_aside"] == 1


def test_slivers_of_somebody_right_behind_are_parts_behind_and_a_hand_is_one_before() -> None:
    depth = np.full((140, 50), 2_500, np.uint16)
    assert cues_of(block(140, 50), depth)["parts_count"] == 0
    depth[10:30, :2] = 2_750
    depth[60:64, 20:40] = 2_350
    cues = cues_of(block(140, 50), depth)
    assert cues["parts_count"] == 2
    assert cues["behind_share"] == pytest.approx(2 * 20 / (140 * 50))
    assert cues["behind_gap_m"] == pytest.approx(0.25, abs=0.01)
    assert cues["behind_lower_m"] == pytest.approx(10 * 2.5 / FOCAL_PX)
    assert cues["behind_head_share"] > 0.01
    assert cues["before_gap_m"] == pytest.approx(0.15, abs=0.01)
    assert cues["before_width_m"] == pytest.approx(18 * 2.5 / FOCAL_PX)  # its edge is taken away
    depth[:, :] = np.linspace(2_400, 3_000, 50)  # a shoulder that is turned away has no step
    assert cues_of(block(140, 50), depth)["parts_count"] == 0


@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (5, 60), (200, 150)])
def test_any_shape_has_finite_cues(shape: tuple[int, int]) -> None:
    cues = cues_of(block(*shape), left=0, top=0)
    assert tuple(cues) == CUES
    assert all(math.isfinite(value) for value in cues.values())


def test_trees_add_up_the_leaves_that_the_cues_lead_to() -> None:
    trees = trees_of(msgspec.convert(STUMP, Table))
    cues = np.zeros(len(CUES))
    assert trees.log_odds(cues) == pytest.approx(-0.5 - 1.0 - 0.5)
    cues[CUES.index("area_m2")] = 0.9
    assert trees.log_odds(cues) == pytest.approx(-0.5 + 2.0 - 0.5)
    cues[CUES.index("saddle_m")] = 0.2
    assert trees.log_odds(cues) == pytest.approx(-0.5 + 2.0 + 1.0)


def test_a_model_of_other_cues_is_refused() -> None:
    with pytest.raises(ValueError, match="other cues"):
        trees_of(msgspec.convert({**STUMP, "cues": ["area_m2"]}, Table))


def test_the_shipped_model_is_whole_and_finds_the_obvious() -> None:
    text = (resources.files("clients.robot.hiding") / "companion-model.json").read_text(encoding="utf-8")
    assert len(text) < 300_000
    table = json.loads(text)
    model = shipped_model()
    assert model.feature.size == np.array(table["value"]).size
    assert model.feature.max() < len(CUES)
    assert model.suspect <= model.certain


@pytest.fixture
def watch() -> CompanionWatch:
    return CompanionWatch(trees_of(msgspec.convert(STUMP, Table)))


def seen(odds: float, x_m: float = 0.0, withhold_reason: str | None = None) -> Silhouette:
    whole = withhold_reason if withhold_reason is not None else ("merged" if odds > STUMP_SUSPECT else "")
    return Silhouette(1, (0, 0, 9, 9), x_m, 3.0, 3.0, 2_900, whole, companion_odds=odds, ahead_m=3.0, right_m=x_m)


def play(watch: CompanionWatch, odds: list[float], first_ms: int = 0) -> list[str]:
    return [watch.step((seen(value),), first_ms + 100 * i)[0].withhold_reason for i, value in enumerate(odds)]


def test_one_odd_frame_of_a_single_person_is_withheld_and_ends_no_track(watch: CompanionWatch) -> None:
    assert play(watch, [-4.0] * 10 + [1.0] + [-4.0] * 3) == [""] * 10 + ["contact"] + [""] * 3


def test_one_frame_that_hides_the_companion_shows_nobody(watch: CompanionWatch) -> None:
    assert play(watch, [2.0] * 10 + [-1.0] + [2.0] * 3) == ["merged"] * 14


def test_a_silhouette_that_is_certainly_two_is_merged_at_once(watch: CompanionWatch) -> None:
    assert play(watch, [-4.0] * 10 + [4.0])[-1] == "merged"


def test_who_is_joined_becomes_two_and_who_is_left_becomes_one(watch: CompanionWatch) -> None:
    withhold_reasons = play(watch, [-4.0] * 10 + [2.5] * 20 + [-4.0] * 20)
    assert withhold_reasons[29] == "merged"
    assert withhold_reasons[-1] == ""
    assert "" not in withhold_reasons[10:31]


def test_two_people_apart_are_pooled_each_for_themselves(watch: CompanionWatch) -> None:
    for step in range(12):
        pair, single = watch.step((seen(2.0, -1.0), seen(-3.0, 1.0)), 100 * step)
        assert (pair.withhold_reason, single.withhold_reason) == ("merged", "")


def test_a_first_sight_and_a_return_are_judged_by_themselves(watch: CompanionWatch) -> None:
    assert play(watch, [1.0]) == ["merged"]
    assert play(watch, [-1.0], first_ms=5_000) == [""]


def test_other_troubles_stay(watch: CompanionWatch) -> None:
    (kept,) = watch.step((seen(-3.0, withhold_reason="occluded"),), 0)
    assert kept.withhold_reason == "occluded"
