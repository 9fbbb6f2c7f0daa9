"""Scenario files: the published run says what the log says, and a wrong file is refused with a sentence."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from clients.robot.scenario import parse_scenario, published_run_1
from clients.robot.synthetic.body import chest_distance_m
from consensus.errors import BlockRobotError


def test_the_published_run_has_the_logged_readings_and_two_a_second_between() -> None:
    scenario = published_run_1()
    patient = next(person for person in scenario.people if person.alias == "patient-a")
    assert patient.readings_s == (3.400, 5.959, 8.309, 11.192)
    times = patient.reading_times_s()
    assert set(patient.readings_s) <= set(times)
    assert max(after - before for before, after in pairwise(times)) <= 0.62
    assert (times[0], times[-1]) == (3.400, 11.192)
    assert scenario.frame_count == 1500


def test_only_the_visitor_is_untagged() -> None:
    assert published_run_1().tagged_aliases == ("patient-a", "patient-b")
    assert {person.alias for person in published_run_1().people} == {"patient-a", "patient-b", "visitor"}


def test_patient_a_is_in_view_for_the_whole_covered_time() -> None:
    patient = published_run_1().people[0]
    for tenth in range(163):
        place = patient.place(tenth / 10)
        assert place is not None
        assert abs(place[0]) / place[1] < 0.5


def test_people_who_share_the_picture_stand_more_than_a_metre_apart_in_range() -> None:
    scenario = published_run_1()
    for tenth in range(74, 127):
        ranges = [chest_distance_m(person, tenth / 10, scenario.camera_height_m) for person in scenario.people]
        near, middle, far = (value if value is not None else math.nan for value in ranges)
        assert middle - near > 0.85
        assert far - middle > 0.85


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "small"\n', "", "lacks 'name'"),
        ("frame_rate = 10", "frame_rate = 0", "frame_rate"),
        ("frame_rate = 10", 'frame_rate = "many"', "wrong kind"),
        ("duration_s = 0.6", "duration_s = 1e9", "duration_s"),
        ("[0.6, 0.0, 2.2]", "[0.0, 0.0, 2.2]", "rising time"),
        ("readings_s = [0.1, 0.5]", "readings_s = [0.1, 5.0]", "not there"),
        ("seed = 7", "seed = ", "not valid TOML"),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_reason(small_text: str, old: str, new: str, says: str) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID") as refused:
        parse_scenario(small_text.replace(old, new))
    assert says in refused.value.detail
