"""Attackers find a person who was planted in a picture, and nothing where nobody is."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.cutouts import extract_cutout
from clients.robot.hiding.segmentation import segment
from clients.robot.sensing.sensor_events import Depth, Mask
from consensus.errors import BlockRobotError
from network.lab.hiding import learned
from network.lab.hiding.features import NAMES, features
from network.lab.hiding.hand_made import HAND_MADE, by_bite, by_difference, by_holes
from network.lab.hiding.learned import Example, train
from network.lab.hiding.run_scene import spread
from network.lab.hiding.scenes import View, blur_others, half_view, show_owner_only
from network.lab.hiding.scoring import iou

HEIGHT, WIDTH = 240, 320
WALL_MM, OWNER_MM, OTHER_MM = 4000, 2000, 2600
FOCAL_PX = 262.5


def box(left: int, top: int, width: int, height: int) -> Mask:
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[top : top + height, left : left + width] = True
    return mask


OWNER, OTHER, NOBODY = box(60, 60, 50, 150), box(180, 80, 40, 120), box(0, 0, 0, 0)


def noisy(rng: np.random.Generator) -> Depth:
    return np.rint(rng.normal(WALL_MM, 12, (HEIGHT, WIDTH))).astype(np.uint16)


def scene(rng: np.random.Generator, other: Mask, value: int = OTHER_MM) -> Depth:
    picture = noisy(rng)
    picture[OWNER] = OWNER_MM
    picture[other] = value
    return picture


def view_of(picture: Depth, owner: Mask = OWNER) -> View:
    return half_view(picture, np.full((HEIGHT, WIDTH), WALL_MM, dtype=np.uint16), owner)


def half(mask: Mask) -> Mask:
    return np.ascontiguousarray(mask[::2, ::2])


def test_the_other_is_found_by_difference_blurred_or_as_a_hole_or_bite() -> None:
    found = by_difference(view_of(scene(np.random.default_rng(1), OTHER)))
    assert iou(found, half(OTHER)) > 0.9
    blurred = blur_others(scene(np.random.default_rng(1), OTHER), OTHER)
    assert iou(by_difference(view_of(blurred)), half(OTHER)) > 0.9
    assert iou(by_holes(view_of(scene(np.random.default_rng(1), OTHER, 0))), half(OTHER)) > 0.9
    bite = box(90, 100, 20, 60)
    assert iou(by_bite(view_of(noisy(np.random.default_rng(1)), OWNER & ~bite)), half(bite)) > 0.9


@pytest.mark.parametrize("name", sorted(HAND_MADE))
def test_nothing_is_found_where_only_the_owner_is(name: str) -> None:
    rng = np.random.default_rng(2)
    shown = show_owner_only(np.where(OWNER, scene(rng, OTHER), np.uint16(0)), noisy(rng))
    assert np.count_nonzero(HAND_MADE[name](view_of(shown)) & half(OTHER)) == 0


def test_our_rendition_holds_no_pixel_of_the_other() -> None:
    """By the robot's own segmentation and cut, which know nothing of the truth."""
    rng = np.random.default_rng(2)
    background = learn_background([noisy(rng) for _ in range(12)])
    depth = scene(rng, OTHER)
    segmented = segment(depth, background, FOCAL_PX)
    assert len(segmented.silhouettes) == 2
    owner = min(segmented.silhouettes, key=lambda silhouette: silhouette.median_mm)
    kept = spread(extract_cutout(depth, background, segmented, owner), depth.shape)
    assert np.count_nonzero(kept[OTHER]) == 0
    assert np.count_nonzero(kept[OWNER]) > 0.95 * np.count_nonzero(OWNER)
    assert np.count_nonzero((kept > 0) & ~OWNER) < 0.02 * np.count_nonzero(OWNER)
    shown = show_owner_only(kept, noisy(rng))
    assert abs(float(shown[OTHER].mean()) - WALL_MM) < 20


def test_who_is_inside_the_owners_cut_is_found_by_the_outline() -> None:
    rng = np.random.default_rng(2)
    kept = np.where(OWNER | OTHER, scene(rng, OTHER), np.uint16(0))
    view = view_of(show_owner_only(kept, noisy(rng)), kept > 0)
    found = {name: iou(attack(view), half(OTHER)) for name, attack in HAND_MADE.items()}
    assert found.pop("outline") > 0.3
    assert max(found.values()) < 0.3


def test_every_feature_has_a_name_and_is_finite_even_without_an_owner() -> None:
    for owner in (OWNER, NOBODY):
        table = features(view_of(scene(np.random.default_rng(3), OTHER), owner))
        assert table.shape == (HEIGHT // 2, WIDTH // 2, len(NAMES))
        assert np.isfinite(table).all()


def test_a_learned_attacker_finds_the_other_in_a_scene_it_has_not_seen_and_nobody_in_the_control() -> None:
    rng = np.random.default_rng(4)
    others = [box(int(rng.integers(130, 260)), int(rng.integers(40, 100)), 40, 120) for _ in range(8)]
    attacker = train([Example(view_of(scene(rng, other)), half(other)) for other in others], seed=1, trees=15)
    assert iou(attacker.recover(view_of(scene(rng, OTHER))), half(OTHER)) > 0.85
    assert np.count_nonzero(attacker.recover(view_of(scene(rng, NOBODY)))) < 20
    assert attacker.recover(view_of(scene(rng, OTHER)), every=2).shape == (HEIGHT // 2, WIDTH // 2)


def test_without_the_extra_the_judge_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learned.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BlockRobotError) as refused:
        train([], seed=1)
    assert refused.value.code == "EXTRA_MISSING"
    assert "attack" in refused.value.entry.next_step
