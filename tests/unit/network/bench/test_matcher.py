"""The judge of the matcher: it counts what the matcher does, and cannot be talked into a better figure."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.sensing.sensor_events import Facing
from network.cli.measure.bench_commands import bench
from network.lab.matcher import matcher_evaluation as matcher_module
from network.lab.matcher.matcher_draws import TRACK_MS, Bearer, Drawn, Setting, draw
from network.lab.matcher.matcher_evaluation import (
    GROUPS,
    Outcome,
    gap_name,
    headline,
    judge,
    judge_matcher,
    measure_cost,
    meets_goals,
    play,
    settings_of,
    upper_bound,
)

EASY = Setting(rate_hz=5, sigma_m=0.3, people=2, bearer="present")


def drawn(setting: Setting, *, gap: str = "over-1m") -> Drawn:
    """The first draw of a setting whose gap is of that kind."""
    return next(d for d in (draw(setting, 1, i) for i in range(200)) if gap_name(d.gap_m) == gap)


def test_a_draw_is_fixed_by_its_seed_misses_three_readings_of_ten_and_can_lack_facing_or_distance() -> None:
    assert draw(EASY, 1, 2) != draw(EASY, 1, 3)
    first, again = draw(EASY, 1, 2), draw(EASY, 1, 2)
    assert first.readings == again.readings
    assert [track.ranges for track in first.tracks] == [track.ranges for track in again.tracks]
    count = sum(len(draw(EASY, 1, i).readings) for i in range(40))
    assert count == pytest.approx(0.7 * 40 * 5 * TRACK_MS / 1000, rel=0.05)
    blind = draw(Setting(2, 0.3, 2, "present", facing=False, distance=False), 1, 1)
    assert {r.facing for r in blind.readings} == {Facing.UNKNOWN}
    assert {r.distance_m for r in blind.readings} == {None}


@pytest.mark.parametrize(("understated", "factor"), [(False, 1.0), (True, 2.0)])
def test_errors_are_as_large_as_the_setting_says(understated: bool, factor: float) -> None:
    setting = Setting(5, 0.5, 1, "present", understated=understated)
    errors = []
    for i in range(60):
        d = draw(setting, 2, i)
        errors += [
            r.distance_m - (d.tracks[0].place_at(r.middle_ms) or (0.0, 0.0))[0] for r in d.readings if r.distance_m
        ]
        assert {r.sigma_m for r in d.readings} == {0.5}
    assert np.std(errors) == pytest.approx(np.hypot(0.5 * factor, 0.15), rel=0.05)


def test_drifting_errors_are_alike_from_one_reading_to_the_next() -> None:
    def likeness(drifting: bool) -> float:
        before, after = [], []
        for i in range(60):
            d = draw(Setting(5, 0.5, 1, "present", drifting=drifting), 3, i)
            off = [(r.distance_m or 0) - (d.tracks[0].place_at(r.middle_ms) or (0.0, 0.0))[0] for r in d.readings]
            before += off[:-1]
            after += off[1:]
        return float(np.corrcoef(before, after)[0, 1])

    assert likeness(drifting=True) > 0.8
    assert likeness(drifting=False) < 0.25


def test_who_is_behind_the_robot_is_heard_behind_and_who_is_in_view_in_front() -> None:
    def front(bearer: str) -> float:
        readings = [r for i in range(40) for r in draw(Setting(2, 0.3, 2, bearer), 4, i).readings]  # type: ignore[arg-type]
        return sum(r.facing is Facing.FRONT for r in readings) / len(readings)

    assert front("present") > 0.85
    assert front("aside") > 0.85
    assert front("behind") < 0.15


def errors_of(setting: Setting, seed: int) -> list[list[float]]:
    made = []
    for i in range(60):
        d = draw(setting, seed, i)
        made.append([(r.distance_m or 0) - (d.tracks[0].place_at(r.middle_ms) or (0.0, 0.0))[0] for r in d.readings])
    return made


def test_draws_off_the_matchers_assumptions_are_off_them() -> None:
    """Weaker antennas, a larger bias, drift over longer, reflections, and a camera whose ranges are not the truth."""

    def front(bearer: Bearer, *, weak: bool) -> float:
        setting = Setting(2, 0.3, 2, bearer, weak_fronts=weak)
        readings = [r for i in range(60) for r in draw(setting, 4, i).readings]
        return sum(r.facing is Facing.FRONT for r in readings) / len(readings)

    assert front("present", weak=True) == pytest.approx(0.75, abs=0.05)
    assert front("behind", weak=True) == pytest.approx(0.25, abs=0.05)
    plain = Setting(5, 0.3, 1, "present")
    biases = [float(np.median(errors)) for errors in errors_of(replace(plain, bias_sigma_m=0.4), 5)]
    assert np.std(biases) == pytest.approx(0.4, rel=0.2)
    far = [max(errors) for errors in errors_of(replace(plain, outliers=True), 5)]
    assert np.median(far) > 2.0
    assert np.median([max(errors) for errors in errors_of(plain, 5)]) < 1.2
    exact, measured = draw(plain, 5, 1), draw(replace(plain, ranges_off=True), 5, 1)
    off = np.subtract(measured.tracks[0].ranges, exact.tracks[0].ranges)
    assert 0.05 < np.std(off) < 0.3
    assert exact.readings == measured.readings


def test_drift_over_longer_keeps_errors_alike_for_longer() -> None:
    def likeness(drift_s: float) -> float:
        pairs: list[tuple[float, float]] = []
        for errors in errors_of(Setting(5, 0.5, 1, "present", drifting=True, drift_s=drift_s, bias_sigma_m=0.0), 3):
            pairs += zip(errors[:-14], errors[14:], strict=True)  # about four seconds later
        return float(np.corrcoef(*zip(*pairs, strict=True))[0, 1])

    assert likeness(6.0) > likeness(2.0) + 0.15


def test_groups_that_were_added_change_no_draw_of_the_first_six(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers: list[int] = []
    monkeypatch.setattr(matcher_module, "draw", lambda *of: numbers.append(of[2]) or draw(*of))  # type: ignore[func-returns-value]
    for group in GROUPS:
        matcher_module._judge_chunk((group, 0, 2, 1))
    assert numbers[:12] == [0, 6, 1, 7, 2, 8, 3, 9, 4, 10, 5, 11]
    assert len(set(numbers)) == len(numbers)


def test_the_bearer_apart_from_others_is_bound_and_without_distance_nobody() -> None:
    outcome = judge("facing", drawn(EASY))
    assert not outcome.wrong
    assert outcome.bound_at_ms is not None
    assert outcome.withheld is not None
    assert outcome.withheld < 0.2
    blind = draw(Setting(5, 0.3, 1, "present", distance=False), 1, 1)
    assert {number for _, number in play(blind)} == {None}
    assert judge("no-distance", blind).withheld == 1.0


def test_binding_to_somebody_else_for_a_moment_counts_as_wrong() -> None:
    """A draw whose truth is exchanged: the matcher binds the one whom the judge now holds for a stranger."""
    right = drawn(EASY)
    other = Drawn(right.setting, right.tracks, right.readings, 3 - (right.bearer or 0), right.gap_m)
    assert judge("facing", other).wrong
    nobody = Drawn(right.setting, right.tracks, right.readings, None, right.gap_m)
    assert judge("facing", nobody).wrong
    assert judge("facing", nobody).withheld is None


def test_frames_before_the_buffer_count_as_withheld() -> None:
    """Who is bound for the first time after fifteen seconds has lost the first five."""
    d = drawn(EASY)
    late = Drawn(d.setting, d.tracks, tuple(r for r in d.readings if r.middle_ms > 15_000), d.bearer, d.gap_m)
    outcome = judge("facing", late)
    assert outcome.bound_at_ms is not None
    assert outcome.withheld == pytest.approx((outcome.bound_at_ms - 10_000) / TRACK_MS, abs=0.01)


def test_the_bound_is_that_of_the_binomial_and_one_in_five_hundred_wrong_misses_the_goal() -> None:
    assert upper_bound(0, 100) == pytest.approx(1 - 0.05 ** (1 / 100))
    assert upper_bound(5, 5) == 1.0
    assert upper_bound(3, 1_000) > 0.003
    good = [outcome("facing", wrong=False) for _ in range(500)]
    assert meets_goals(headline(good))
    for group in ("facing", "sigma-understated", "drifting"):
        assert not meets_goals(headline([*good, *(outcome(group, wrong=i == 0) for i in range(400))]))
    assert meets_goals(headline([*good, outcome("no-facing", wrong=True)]))
    assert not meets_goals(headline([outcome("facing", wrong=False, withheld=0.06)]))


def outcome(group: str, *, wrong: bool, withheld: float | None = 0.0) -> Outcome:
    return Outcome(group, EASY, "over-1m", wrong, withheld, None)


def test_a_group_goes_through_every_rate_sigma_number_of_people_and_bearer() -> None:
    settings = settings_of("drifting")
    assert len(set(settings)) == len(settings) == 81
    assert all(setting.drifting for setting in settings)
    assert {setting.bearer for setting in settings_of("aside")} == {"aside"}


def test_the_figures_do_not_depend_on_the_number_of_processes() -> None:
    told: list[tuple[int, int]] = []
    one = judge_matcher(30, 7, workers=1, groups=["facing"], progress=lambda done, of: told.append((done, of)))
    two = judge_matcher(30, 7, workers=2, groups=["facing"])
    judged = [name for name in one.figures if not name.startswith(("matcher_", "storm_"))]
    assert {name: one.figures[name] for name in judged} == {name: two.figures[name] for name in judged}
    assert one.strata == two.strata
    assert told == [(1, 1)]
    assert one.figures["wrong_owner_of"] == 30
    assert sum(row["tracks"] for row in one.strata) == 30


def test_the_command_prints_the_figures_and_fails_where_a_goal_is_missed() -> None:
    ended = CliRunner().invoke(bench, ["matcher", "--tracks", "20", "--seed", "3", "--workers", "1", "--json"])
    result = json.loads(ended.stdout)
    assert result["name"] == "matcher"
    assert result["conditions"]["seed"] == 3
    assert ended.exit_code == (0 if result["ok"] else 1)


def test_the_cost_is_measured_and_a_storm_leaves_ten_readings_a_second() -> None:
    cost = measure_cost(1)
    assert cost["storm_held"] == 10
    assert 0 < cost["matcher_frame_ms"] <= cost["matcher_frame_p95_ms"] * 2
    assert cost["storm_reading_us"] > 0
