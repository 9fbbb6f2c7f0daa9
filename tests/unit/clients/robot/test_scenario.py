"""Scenario files: the published run says what the log says, and a wrong file is refused with a sentence."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from clients.robot.synthetic.scenario import parse_scenario, published_run_1
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
        places = [person.place(tenth / 10) for person in scenario.people]
        near, middle, far = (math.nan if place is None else math.hypot(*place) for place in places)
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


HARD = """
[reader]
distance_sigma_m = 0.3
antenna_front = 1
antenna_back = 2
front_misread = 0.0
missed = 0.25
late_s = 1.5

[environment]
mirror_floor = 0.3
holes = 0.02
doors = [{ side = "left", z_m = 3.0, opens_s = 0.2 }]
beds = [{ x_m = 1.9, z_m = 4.0 }]
camera_path = [[0.0, 0.0, 0.0, 0.0], [0.6, 0.1, 0.4, 10.0]]

[[people]]
alias = "bob"
height_m = 1.8
girth = 1.1
cadence = 1.0
with = "ann"
manner = "pushing"
coat = true
stoop_deg = 10
"""


@pytest.fixture(scope="module")
def hard_text(small_text: str) -> str:
    text = small_text.replace('alias = "ann"', 'alias = "ann"\naid = "wheelchair"\nfacing_deg = [[0.0, 0], [0.6, 90]]')
    head, _, rest = text.partition("[reader]")
    return head + HARD + rest[rest.index("[[people]]") :]


def test_a_hard_corridor_is_read_with_all_that_makes_it_hard(hard_text: str) -> None:
    scenario = parse_scenario(hard_text)
    bob, ann = scenario.people
    environment = scenario.environment
    assert (ann.aid, bob.manner, bob.accompanies, bob.arms, bob.coat) == (
        "wheelchair",
        "pushing",
        "ann",
        "forward",
        True,
    )
    assert (scenario.reader.missed, scenario.reader.late_s) == (0.25, 1.5)
    assert (environment.mirror_floor, environment.holes, environment.doors[0].side, environment.beds[0].from_s) == (
        0.3,
        0.02,
        "left",
        0.0,
    )
    assert scenario.camera_at(0.3) == pytest.approx((0.05, 0.2, math.radians(5)))
    assert ann.heading(0.6)[0] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('aid = "wheelchair"', 'aid = "scooter"', "aid = 'scooter' is none of wheelchair"),
        ('aid = "wheelchair"', 'kind = "giant"', "kind = 'giant'"),
        ('aid = "wheelchair"', "", "nothing to be pushed in"),
        ('manner = "pushing"', 'manner = "tickling"', "manner = 'tickling'"),
        ('manner = "pushing"', "", "in a manner"),
        ('with = "ann"', 'with = "carl"', "bob must be with another person"),
        ('with = "ann"', 'with = "ann"\npath = [[0, 0, 2], [1, 0, 2]]', "bob needs a path, or somebody to be with"),
        ('with = "ann"', 'with = "ann"\nlimp = 3', "limp of bob must be between 0 and 1"),
        ("coat = true", 'coat = "yes"', "coat must be true or false"),
        ("stoop_deg = 10", "stoop_deg = 100", "stoop_deg of bob"),
        ("facing_deg = [[0.0, 0], [0.6, 90]]", "facing_deg = [[0.6, 0], [0.0, 90]]", "facing_deg of ann"),
        ("missed = 0.25", "missed = 1.25", "reader.missed"),
        ("late_s = 1.5", "late_s = -1", "reader.late_s"),
        ("holes = 0.02", "holes = 0.9", "environment.holes"),
        ("mirror_floor = 0.3", "mirror_floor = nan", "mirror_floor"),
        ("opens_s = 0.2", "opens_s = 0.2, closes_s = 0.1", "a door must close after it opens"),
        ('side = "left"', 'side = "up"', "side = 'up'"),
        ("[0.6, 0.1, 0.4, 10.0]", "[0.0, 0.1, 0.4, 10.0]", "camera_path of the robot"),
        ("[0.6, 0.0, 2.2]", "[nan, 0.0, 2.2]", "path of ann"),
    ],
)
def test_a_wrong_hard_corridor_is_refused_with_its_reason(hard_text: str, old: str, new: str, says: str) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID") as refused:
        parse_scenario(hard_text.replace(old, new))
    assert says in refused.value.detail
