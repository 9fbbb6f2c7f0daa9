"""Bodies and what they bring: each kind takes the room that it should, where it should, and props say so."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.synthetic.body import Capsules, pose
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Aid, Person, Scenario, joined

ANN = Person("ann", 1.7, 1.0, 1.0, ((0.0, 0.0, 2.5), (4.0, 0.0, 2.5)), (), 0.0)


def body_of(person: Person, at_s: float = 1.0) -> Capsules:
    found = pose(person, at_s)
    assert found is not None
    return found


def top_of(body: Capsules) -> float:
    ends = np.maximum(body.start[:, 1], body.end[:, 1]) + body.radius
    return float(ends[: len(ends) - body.props].max())


def reach(body: Capsules, axis: int) -> float:
    points = np.concatenate([body.start[:, axis], body.end[:, axis]])
    return float(points.max() - points.min())


def test_a_person_is_as_tall_as_said_whether_upright_seated_or_in_a_bed() -> None:
    for height in (1.0, 1.55, 1.95):
        body = body_of(replace(ANN, height_m=height))
        assert top_of(body) == pytest.approx(height, abs=0.03)
        assert 0 <= (np.minimum(body.start[:, 1], body.end[:, 1])).min() < 0.1
    seated, lying = body_of(replace(ANN, aid="wheelchair")), body_of(replace(ANN, aid="bed"))
    assert 1.15 < top_of(seated) < 1.45
    assert top_of(lying) < 1.1
    assert reach(lying, 2) > 1.8
    seated = replace(ANN, aid="wheelchair")
    assert seated.chest_height_m < ANN.chest_height_m - 0.2


@pytest.mark.parametrize("aid", ["wheelchair", "rollator", "stick", "iv-pole", "bed", "bag"])
def test_every_aid_is_drawn_and_belongs_to_its_person(small_scenario: Scenario, aid: Aid) -> None:
    person = replace(small_scenario.people[0], aid=aid)
    truth = Renderer(replace(small_scenario, people=(person,))).truth(2)
    assert np.count_nonzero(truth.props) > 5
    assert set(np.unique(truth.props)) == {0, 1}
    assert set(np.unique(truth.labels)) == {0, 1}
    assert np.all(truth.labels[truth.props > 0] == 1)


def test_a_person_without_aid_has_no_prop(small_scenario: Scenario) -> None:
    assert not Renderer(small_scenario).truth(2).props.any()


def test_heads_arms_build_and_clothes_change_the_shape_of_a_person() -> None:
    adult, child = body_of(replace(ANN, height_m=1.2)), body_of(replace(ANN, height_m=1.2, kind="child"))
    assert child.radius[0] > 1.2 * adult.radius[0]
    assert top_of(body_of(replace(ANN, arms="raised"))) > 1.8
    towards_robot = min(float(body_of(replace(ANN, arms="around")).end[:, 2].min()), 99.0)
    assert towards_robot < 2.5 - 0.4
    plain = body_of(ANN)
    assert reach(body_of(replace(ANN, shoulders=1.2)), 0) > reach(plain, 0)
    assert len(body_of(replace(ANN, coat=True)).radius) == len(plain.radius) + 3
    assert body_of(replace(ANN, belly=0.5)).radius.max() > plain.radius.max()
    assert top_of(body_of(replace(ANN, stoop=math.radians(30)))) < top_of(plain) - 0.05


def test_a_person_faces_where_told_or_where_they_walk_or_the_robot() -> None:
    walking = replace(ANN, path=((0.0, 0.0, 2.0), (4.0, 2.0, 2.0)))
    assert ANN.heading(1.0)[0] == 0.0
    assert walking.heading(1.0)[0] == pytest.approx(math.pi / 2)
    turning = replace(ANN, facing=((0.0, 0.0), (4.0, math.pi)))
    assert turning.heading(2.0)[0] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("manner", "apart"), [("arm-in-arm", 0.46), ("embrace", 0.31), ("pushing", 0.72), ("close-behind", 0.46)]
)
def test_a_companion_keeps_its_place_beside_who_it_is_with(manner: str, apart: float) -> None:
    leader = replace(ANN, aid="wheelchair", path=((0.0, -1.0, 2.0), (2.0, 1.0, 2.5), (4.0, 0.0, 4.0)))
    row = {"accompanies": "ann", "manner": manner, "alias": "bob", "path": ()}
    ann, bob = joined((leader, replace(leader, **row, aid="")))  # type: ignore[arg-type]
    for at_s in (0.3, 1.1, 2.6, 3.9):
        here, there = ann.place(at_s), bob.place(at_s)
        assert here is not None
        assert there is not None
        assert math.dist(here, there) == pytest.approx(apart, abs=0.1)
    assert bob.arms == {"embrace": "around", "pushing": "forward", "arm-in-arm": "hooked-left"}.get(manner, "")
