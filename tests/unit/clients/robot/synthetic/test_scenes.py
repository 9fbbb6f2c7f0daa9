"""Random scenes: the same seed draws the same bytes, strata are what they say, a control is the scene less one."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from clients.robot.sensing.sensor_events import Facing
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Bed, Door, Scenario
from clients.robot.synthetic.scenes import STRATA, Stratum, draw_scene, without
from clients.robot.synthetic.tag_readings import readings
from consensus.errors import BlockRobotError

SEEDS = range(4)
DOOR = Door("left", 3.0, 0.9, 3.0, 9.0)
BED = Bed(1.9, 4.0, 4.0)
SHADOW_PX = 13  # the widest shadow and the jitter


def small(scene: Scenario) -> Scenario:
    """Return the scene with a quarter of the pixels each way, which is quick to render."""
    return replace(scene, width=160, height=120, focal_px=131.25)


def distance(scene: Scenario, at_s: float) -> float:
    owner, other = (scene.people[i].place(at_s) for i in (0, 1))
    assert owner is not None
    assert other is not None
    return math.dist(owner, other)


@pytest.mark.parametrize("stratum", STRATA)
def test_the_same_seed_draws_the_same_scene_and_bytes(stratum: Stratum) -> None:
    one, two = (draw_scene(11, stratum) for _ in range(2))
    assert one == two
    assert one.digest != draw_scene(12, stratum).digest
    assert np.array_equal(Renderer(small(one)).frame(33), Renderer(small(two)).frame(33))
    assert [r.distance_m for r in readings(one)] == [r.distance_m for r in readings(two)]


@pytest.mark.parametrize("stratum", STRATA)
def test_everybody_is_there_all_the_time_and_the_owner_is_tagged(stratum: Stratum) -> None:
    for seed in SEEDS:
        scene = draw_scene(seed, stratum)
        assert "owner" in scene.tagged_aliases
        assert (len(scene.people) > 1) == (stratum in STRATA[:7])
        for person in scene.people:
            assert all(person.place(t / 10) is not None for t in range(round(scene.duration_s * 10)))


def test_strata_are_as_far_apart_as_they_say() -> None:
    for seed in SEEDS:
        times = [t / 10 for t in range(120)]
        assert min(distance(draw_scene(seed, "apart"), t) for t in times) > 1.2
        assert max(distance(draw_scene(seed, "touching"), t) for t in times) < 0.65
        assert 0.6 < min(distance(draw_scene(seed, "close"), t) for t in times) < 1.3
        crossing = draw_scene(seed, "crossing")
        angles = [[math.atan2(*(p.place(t) or (0, 1))) for t in times] for p in crossing.people[:2]]
        assert any((a - b) * (c - d) < 0 for (a, b), (c, d) in pairwise(zip(*angles, strict=True)))


def test_the_bearer_behind_is_not_in_the_picture_and_is_read_by_the_back_antenna() -> None:
    scene = draw_scene(3, "bearer-behind", third=False)
    own = [reading for reading in readings(scene) if reading.alias == "owner"]
    assert sum(reading.facing is Facing.BACK for reading in own) > 0.7 * len(own)
    assert not (Renderer(small(scene)).truth(40).labels == 1).any()


def shift_px(scene: Scenario) -> float:
    """Return by how many columns one who stands still moves in the picture."""
    owner = replace(scene.people[0], path=((0.0, 0.4, 3.0), (12.0, 0.4, 3.0)), aid="")
    renderer = Renderer(small(without(replace(scene, people=(owner, *scene.people[1:])), "other")))
    first, last = (float(np.nonzero(renderer.truth(i).labels == 1)[1].mean()) for i in (0, 84))
    return abs(last - first)


def test_a_moving_robot_sees_who_stands_still_move() -> None:
    moving = draw_scene(5, "moving-robot", third=False)
    assert shift_px(moving) > 3
    assert shift_px(replace(moving, environment=replace(moving.environment, camera_path=()))) < 1


@pytest.mark.parametrize("stratum", ["close", "crossing", "companion"])
def test_a_control_differs_only_where_the_other_was_or_cast_shadows(stratum: Stratum) -> None:
    scene = small(draw_scene(8, stratum, third=False))
    still = replace(scene.environment, mirror_floor=0.0)
    scene = replace(scene, environment=still)
    full, control = Renderer(scene), Renderer(without(scene, "other"))
    for index in (20, 50):
        seen, alone = full.truth(index), control.truth(index)
        assert not (alone.labels == 2).any()
        rows, columns = np.nonzero(seen.labels == 2)
        allowed = np.zeros(seen.depth.shape, dtype=bool)
        allowed[max(0, rows.min() - 3) : rows.max() + 4, max(0, columns.min() - SHADOW_PX) : columns.max() + 4] = True
        assert not (seen.depth != alone.depth)[~allowed].any()
        assert (seen.depth != alone.depth).any()


def test_a_control_keeps_labels_and_readings_of_those_who_stay() -> None:
    scene = draw_scene(8, "apart")
    control = without(scene, "other")
    assert [r.distance_m for r in readings(control)] == [r.distance_m for r in readings(scene) if r.alias != "other"]
    assert control.digest != scene.digest
    assert (Renderer(small(control)).truth(30).labels == 1).any()
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        without(scene, "nobody")


def test_readings_are_missed_and_late() -> None:
    scene = draw_scene(9, "single")
    reader = replace(scene.reader, missed=0.0, late_s=0.0)
    all_in_time = readings(replace(scene, reader=reader))
    some_late = readings(replace(scene, reader=replace(reader, missed=0.3, late_s=2.0)))
    assert all(r.arrives_s == r.at_s for r in all_in_time)
    assert 0.4 * len(all_in_time) < len(some_late) < len(all_in_time)
    assert 0 < max(r.arrives_s - r.at_s for r in some_late) <= 2.0
    assert [r.arrives_s for r in some_late] == sorted(r.arrives_s for r in some_late)


def test_a_door_opens_a_bed_appears_and_a_mirroring_floor_shows_no_label() -> None:
    scene = draw_scene(1, "single")
    environment = scene.environment
    plain = replace(environment, doors=(), beds=(), mirror_floor=0.0, holes=0.0)
    bare = Renderer(small(replace(scene, environment=plain))).truth(60)
    for changed in (
        replace(plain, doors=(DOOR,)),
        replace(plain, beds=(BED,)),
        replace(plain, mirror_floor=0.6),
        replace(plain, holes=0.05),
    ):
        truth = Renderer(small(replace(scene, environment=changed))).truth(60)
        assert np.mean(truth.depth != bare.depth) > 0.005
        assert set(np.unique(truth.labels)) <= {0, 1}
    before = Renderer(small(replace(scene, environment=replace(plain, doors=(DOOR,))))).truth(5)
    assert np.array_equal(before.depth, Renderer(small(replace(scene, environment=plain))).truth(5).depth)
