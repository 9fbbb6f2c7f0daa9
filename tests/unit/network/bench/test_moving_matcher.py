"""The judge of the matcher of a robot that drives: its draws are true to their geometry, and it sees what is wrong."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.sensing.sensor_events import Facing, Sighting
from network.cli.measure.bench_commands import bench
from network.lab.matcher.matcher_draws import TIMES_S, TRACK_MS, Array, Bearer, Setting
from network.lab.matcher.matcher_evaluation import settings_of
from network.lab.matcher.moving_draws import (
    BESIDE_DEG,
    GREETING_S,
    HEARD_MAX_M,
    STORIES,
    MovingDraw,
    Story,
    draw_moving,
    front_weight,
    is_driving,
    locate,
    see,
)
from network.lab.matcher.moving_evaluation import (
    MOVING_BEARERS,
    MOVING_GROUPS,
    SEEN_EVERY,
    MovingOutcome,
    Ruled,
    case_of,
    judge_moving,
    judge_moving_matcher,
    moving_headline,
    play_moving,
    silhouettes,
)

PLAIN = Setting(rate_hz=5, sigma_m=0.3, people=2, bearer="present")
FRAMES_COUNT = len(TIMES_S[::SEEN_EVERY])


def test_a_draw_is_fixed_by_its_seed_and_every_setting_meets_every_story() -> None:
    first, again, other = (draw_moving(PLAIN, "past", 1, number) for number in (2, 2, 3))
    assert first.readings == again.readings != other.readings
    assert first.places == again.places
    assert np.array_equal(first.ranges, again.ranges)
    cases = {case_of("drifting", number) for number in range(756)}
    assert len(cases) == 756
    assert {story for _, story in cases} == set(STORIES)
    assert {setting.bearer for setting, _ in cases} == {"present", "absent", "behind", "aside"}
    assert all(setting.drifting for setting, _ in cases)
    counts = {group: len(settings_of(group, MOVING_BEARERS)) for group in MOVING_GROUPS}
    assert {math.gcd(count, len(STORIES)) for count in counts.values()} == {1}, counts


def test_people_are_where_a_robot_that_moved_and_turned_sees_them() -> None:
    """It is 1 m to the right and 2 m ahead of its start, and looks to the right."""
    way = np.array([[1.0], [2.0], [np.pi / 2]])
    ranges, bearings = locate([np.array([[x], [z]]) for x, z in ((4.0, 2.0), (1.0, 4.0), (3.0, 0.0), (1.1, 2.0))], way)
    assert ranges.ravel() == pytest.approx([3.0, 2.0, np.sqrt(8), 0.5])
    assert bearings.ravel() == pytest.approx([0.0, -90.0, 45.0, 0.0])


def test_the_camera_sees_who_is_in_its_cone_and_range_and_not_behind_another() -> None:
    def seen(*people: tuple[float, float]) -> list[bool]:
        ranges, bearings = np.array(people).T
        return see(ranges[:, None], bearings[:, None])[0].ravel().tolist()

    assert seen((3.0, 0.0), (3.0, 27.0), (3.0, -29.0), (3.0, 180.0)) == [True, True, False, False]
    assert seen((0.7, 10.0), (6.1, -20.0), (5.9, -12.0)) == [False, False, True]
    assert seen((2.0, 0.0), (4.0, 1.0), (4.0, 8.0)) == [True, False, True]
    assert seen((4.0, 1.0), (2.0, 0.0)) == [False, True]


def test_two_who_touch_are_one_merged_silhouette_between_them() -> None:
    walls = ward([(0.0, 3.0), (0.4, 3.0), (-1.2, 3.0)], lambda at_s: 0.0 * at_s, [])
    found = silhouettes(walls, 0)
    assert [(one.withhold_reason, round(one.right_m, 2)) for one in found] == [("merged", 0.2), ("", -1.2)]


@pytest.mark.parametrize("bearer", ["present", "absent", "behind", "aside"])
def test_the_bearer_is_at_some_time_where_the_setting_says(bearer: Bearer) -> None:
    for number in range(20):
        drawn = draw_moving(replace(PLAIN, bearer=bearer), STORIES[number % len(STORIES)], 2, number)
        angles = np.abs(drawn.bearings[drawn.bearer])
        assert len(drawn.ranges) == (2 if bearer == "present" else 3)
        if bearer == "present":
            assert np.any((angles < 28) & (drawn.ranges[drawn.bearer] < 6.1))
        else:
            assert drawn.bearer == 2
            least, most = BESIDE_DEG[bearer]
            assert np.any((angles > least - 2) & (angles < most + 2))


def test_readings_are_of_the_bearers_range_and_bearing_and_heard_in_front_by_where_they_are() -> None:
    setting = replace(PLAIN, bearing_sigma_deg=9.0, bearer="absent")
    errors, turned, front, weights = [], [], [], []
    for number in range(120):
        drawn = draw_moving(setting, STORIES[number % len(STORIES)], 3, number)
        for reading in drawn.readings:
            at = reading.middle_ms / 1000
            range_m = float(np.interp(at, TIMES_S, drawn.ranges[drawn.bearer]))
            bearing = np.interp(at, TIMES_S, np.unwrap(drawn.bearings[drawn.bearer], period=360))
            assert range_m <= HEARD_MAX_M
            errors.append((reading.distance_m or 0.0) - range_m)
            turned.append(((reading.bearing_deg or 0.0) - bearing + 180) % 360 - 180)
            front.append(reading.facing is Facing.FRONT)
            weights.append(float(front_weight(np.array(bearing))))
    assert np.std(errors) == pytest.approx(np.hypot(0.3, 0.15), rel=0.1)
    assert np.std(turned) == pytest.approx(np.hypot(9.0, 4.0), rel=0.1)
    heard, weight = np.array(front), np.array(weights)
    assert heard[weight > 0.95].mean() == pytest.approx(0.9, abs=0.05)
    assert heard[weight < 0.05].mean() == pytest.approx(0.1, abs=0.05)


def test_each_story_drives_as_its_name_says_and_odometry_tells_so() -> None:
    for number in range(3 * len(STORIES)):
        story = STORIES[number % len(STORIES)]
        drawn = draw_moving(PLAIN, story, 4, number)
        assert bool(drawn.driving.any()) == (story != "stands")
        assert not drawn.driving[: int(1.9 / 0.1)].any()
        if story == "greet":
            assert not drawn.driving[TIMES_S < GREETING_S - 0.2].any()
            assert drawn.driving[TIMES_S > GREETING_S + 0.6].all()
            assert np.ptp(drawn.ranges[0]) < 4.0, "who is greeted is gone along with"
        if story == "second-stop":
            assert not drawn.driving[-30:].any()
        motion = OwnMotion()
        for arrives_ms, place in drawn.places:
            assert 0 < arrives_ms - place.at_ms < 100
            motion.add(place)
        motion.confirm(TRACK_MS)
        stood = [motion.stands(at_ms) for at_ms in range(1_000, TRACK_MS - 1_000, 500)]
        around = [drawn.driving[index - 5 : index + 6] for index in range(10, TRACK_MS // 100 - 10, 5)]
        assert all(told for told, moves in zip(stood, around, strict=True) if not moves.any())
        assert not any(told for told, moves in zip(stood, around, strict=True) if moves.all())


def ward(
    people: list[tuple[float, float]], robot_z: object, heard: list[int], bearer: int = 0, setting: Setting = PLAIN
) -> MovingDraw:
    """People who stand, a robot that drives ahead, and exact readings at these times, all by the antenna in front."""
    way = np.stack([np.zeros_like(TIMES_S), np.asarray(robot_z(TIMES_S), float), np.zeros_like(TIMES_S)])  # type: ignore[operator]
    ranges, bearings = locate([np.array(place)[:, None] * np.ones_like(TIMES_S) for place in people], way)
    in_view, touching = see(ranges, bearings)
    readings = []
    for at_ms in heard:
        distance_m = float(np.interp(at_ms / 1000, TIMES_S, ranges[bearer]))
        readings.append(Sighting(at_ms, at_ms, "", 1, Facing.FRONT, -50.0, distance_m, 0.3))
    places = [
        (round(1000 * at_s) + 50, RobotPlace(round(1000 * at_s), 0.0, z))
        for at_s, z in zip(TIMES_S, way[1], strict=True)
    ]
    driven = is_driving(way)
    return MovingDraw(
        setting, "past", ranges, bearings, ranges, in_view, touching, driven, tuple(places), tuple(readings), bearer
    )


def drives_past(at_s: Array) -> Array:
    return np.asarray(0.4 * np.clip(at_s - 4.0, 0.0, 8.0))


def test_counting_every_reading_takes_a_bearer_beside_the_picture_for_whom_the_robot_drives_towards() -> None:
    """The range to both shrinks alike, and the bearer is heard in front. So readings on the way count for nothing."""
    drawn = ward([(2.8, 4.2), (0.0, 5.0)], drives_past, list(range(5_000, 12_000, 200)))
    assert not drawn.in_view[0].any()
    standing, every = play_moving(drawn)
    assert every.wrong
    assert not standing.wrong
    assert standing.kept == {False: 0, True: 0}


def test_who_is_bound_while_the_robot_stands_is_kept_on_the_way() -> None:
    drawn = ward([(0.0, 5.6), (1.0, 3.6)], drives_past, list(range(0, 4_000, 200)))
    outcome = judge_moving("facing", drawn)
    assert not outcome.standing.wrong
    assert outcome.in_view[False] + outcome.in_view[True] == FRAMES_COUNT
    assert outcome.standing.kept[True] == outcome.in_view[True] > 30
    assert outcome.standing.kept[False] >= outcome.in_view[False] - 1, "the first frame came before any odometry"


def test_somebody_else_bound_for_a_moment_counts_as_wrong_whenever_it_is() -> None:
    drawn = ward([(0.0, 5.6), (1.0, 3.6)], drives_past, list(range(0, 4_000, 200)))
    standing, every = play_moving(replace(drawn, bearer=1))
    assert standing.wrong
    assert every.wrong
    assert standing.kept == {False: 0, True: 0}


def test_who_was_before_a_standing_robot_but_not_in_its_picture_is_counted_apart() -> None:
    beside = judge_moving("facing", ward([(2.8, 4.2), (0.0, 5.0)], drives_past, []))
    behind = judge_moving("facing", ward([(0.0, -4.0), (0.0, 5.0)], drives_past, []))
    assert beside.ahead_unseen
    assert not behind.ahead_unseen
    outcomes = [replace(beside, standing=Ruled(wrong=True)), behind]
    figures = moving_headline(outcomes)
    assert figures["wrong_owner_ahead_unseen_count"] == figures["wrong_owner_ahead_unseen_of"] == 1
    assert figures["wrong_owner_never_ahead_unseen_count"] == 0


def test_one_in_five_hundred_wrong_misses_the_goal_unless_they_stood_beside_the_picture() -> None:
    def outcome(
        *, wrong: bool, group: str = "facing", bearer: Bearer = "present", story: Story = "greet"
    ) -> MovingOutcome:
        return MovingOutcome(
            group, story, bearer, {False: 10, True: 20}, False, Ruled(wrong, {False: 5, True: 5}), Ruled()
        )

    good = [outcome(wrong=False)] * 499
    assert moving_headline([*good, outcome(wrong=True)])["wrong_owner_rate"] == 0.002
    assert moving_headline([*good, outcome(wrong=True, bearer="aside")])["wrong_owner_rate"] == 0
    assert moving_headline([*good, outcome(wrong=True, group="outliers")])["wrong_owner_rate"] == 0
    figures = moving_headline(good)
    assert (figures["kept_standing_rate"], figures["kept_driving_rate"]) == (0.5, 0.25)
    assert figures["every_kept_driving_rate"] == 0


def test_the_figures_do_not_depend_on_the_number_of_processes() -> None:
    one = judge_moving_matcher(14, 7, workers=1, groups=["facing", "bearings"])
    two = judge_moving_matcher(14, 7, workers=2, groups=["facing", "bearings"])
    assert one.figures == two.figures
    assert one.strata == two.strata
    assert sum(int(str(row["tracks"])) for row in one.strata) == one.figures["tracks"] == 14 + 4
    assert {row["story"] for row in one.strata} == set(STORIES)


def test_the_command_prints_the_figures_and_fails_where_the_goal_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = ["matcher", "--moving", "--tracks", "2", "--seed", "3", "--workers", "1", "--json"]
    ended = CliRunner().invoke(bench, typed)
    result = json.loads(ended.stdout)
    assert (result["name"], result["ok"], ended.exit_code) == ("matcher-moving", True, 0)
    assert result["figures"]["wrong_owner_of"] > 0
    monkeypatch.setattr("network.lab.matcher.moving_evaluation.WRONG_MAX_RATE", -1.0)
    assert CliRunner().invoke(bench, typed).exit_code == 1
