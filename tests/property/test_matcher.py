"""What holds of the matcher whatever readers report: in any order, any number of times, of any number of people."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from clients.robot.matching.match_evidence import DISTANCE_LOG_ODDS_MIN
from clients.robot.matching.matcher import BIND_LOG_ODDS, UNBIND_LOG_ODDS, Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_events import Facing, Sighting

LAST_MS = 12_000


def track(number: int, began_ms: int, lasts_ms: int, ranges: tuple[float, float]) -> Track:
    """Somebody who walks from one range to another, followed at 10 Hz."""
    times = list(range(began_ms, began_ms + lasts_ms + 1, 100))
    near, far = ranges
    values = [near + (far - near) * i / len(times) for i in range(len(times))]
    bearings = [8.0 * number - 20 for _ in times]
    return Track(number, times[0], times[-1], 0.0, values[-1], times=times, ranges=values, bearings=bearings)


range_m = st.sampled_from([1.0, 2.0, 2.2, 3.5, 5.0])
people = st.lists(
    st.tuples(st.integers(0, 4_000), st.integers(2_000, LAST_MS), st.tuples(range_m, range_m)), min_size=1, max_size=3
).map(lambda rows: [track(i + 1, *row) for i, row in enumerate(rows)])
errors = st.sampled_from([-0.4, -0.1, 0.0, 0.05, 0.3])
facings = st.sampled_from([Facing.FRONT, Facing.FRONT, Facing.FRONT, Facing.BACK, Facing.UNKNOWN])


@st.composite
def scenes(draw: st.DrawFn) -> tuple[list[Track], list[Sighting]]:
    """People in view, and readings that mostly follow one of them."""
    tracks = draw(people)
    worn = draw(st.sampled_from(tracks))
    row = st.tuples(st.integers(0, LAST_MS), errors, facings, st.booleans(), st.booleans())
    rows = draw(st.lists(row, min_size=5, max_size=30))
    readings = []
    for at, error, facing, measured, located in rows:
        range_m, bearing_deg = worn.place_at(at) or (4.0, 0.0)
        measure = (range_m + error, 0.2) if measured or error == 0.0 else (None, None)
        bearing = (bearing_deg + 40 * error, 8.0) if located else (None, None)
        readings.append(Sighting(at, at, "", 1, facing, -50.0, *measure, *bearing))
    return tracks, readings


def weigh(tracks: list[Track], readings: list[Sighting], *, stepwise: bool = False) -> Matcher:
    """Give readings in this order; weigh them as they come, or all at the end."""
    matcher = Matcher()
    for one in tracks:
        matcher.add_track(one)
    for reading in readings:
        matcher.add_sighting("tag", reading)
        if stepwise:
            matcher.advance(reading.middle_ms)
    matcher.advance(LAST_MS)
    return matcher


def bound(matcher: Matcher, tracks: list[Track]) -> set[int]:
    return {one.number for one in tracks if matcher.bound_track("tag", [one.number]) is not None}


@given(scenes(), st.randoms(use_true_random=False))
def test_the_order_in_which_readings_come_changes_nothing(scene, random) -> None:
    tracks, readings = scene
    mixed = list(readings)
    random.shuffle(mixed)
    ordered = weigh(tracks, sorted(readings, key=lambda r: r.middle_ms))
    for other in (weigh(tracks, mixed), weigh(tracks, mixed, stepwise=True)):
        assert other.log_odds("tag") == ordered.log_odds("tag")
        assert bound(other, tracks) == bound(ordered, tracks)


@given(scenes(), st.integers(2, 5))
def test_duplicates_count_once(scene, times) -> None:
    tracks, readings = scene
    once, often = weigh(tracks, readings), weigh(tracks, readings * times, stepwise=True)
    assert often.log_odds("tag") == once.log_odds("tag")
    assert often.held_count == once.held_count


@given(scenes())
def test_a_tag_is_never_bound_to_two_tracks_that_were_in_view_together(scene) -> None:
    tracks, readings = scene
    matcher = Matcher()
    for one in tracks:
        matcher.add_track(one)
    for reading in sorted(readings, key=lambda r: r.middle_ms):
        matcher.add_sighting("tag", reading)
        matcher.advance(reading.middle_ms)
        mine = [one for one in tracks if one.number in bound(matcher, tracks)]
        assert not any(one.overlaps(other) for one in mine for other in mine if one is not other)


@given(scenes())
def test_nothing_is_ever_bound_without_distance(scene) -> None:
    tracks, readings = scene
    blind = [Sighting(r.first_seen_ms, r.last_seen_ms, "", 1, r.facing) for r in readings]
    matcher = weigh(tracks, blind * 3, stepwise=True)
    assert bound(matcher, tracks) == set()
    assert matcher.log_odds("tag") == {}


@given(scenes())
def test_what_is_bound_is_likelier_than_not_and_what_passes_the_threshold_is_bound(scene) -> None:
    tracks, readings = scene
    matcher = weigh(tracks, readings)
    odds, mine = matcher.log_odds("tag"), bound(matcher, tracks)
    assert all(odds[number] >= UNBIND_LOG_ODDS for number in mine)
    speak = {number for number in odds if says(matcher, number) >= DISTANCE_LOG_ODDS_MIN}
    assert {number for number, value in odds.items() if value >= BIND_LOG_ODDS} & speak <= mine


def says(matcher: Matcher, number: int) -> float:
    """Return what the distances alone say for a track."""
    evidence = matcher.explain("tag", [number])
    assert evidence is not None
    return evidence.distance_log_odds


stated_sigmas_m = st.one_of(st.floats(0.01, 2.0), st.floats(2.0, 1e6))


@given(scenes(), st.sampled_from([100.0, 1000.0]), stated_sigmas_m)
def test_distances_in_a_wrong_unit_bind_nobody_whatever_error_is_stated(scene, factor, sigma_m) -> None:
    tracks, readings = scene
    wrong = [
        replace(r, facing=Facing.FRONT, distance_m=r.distance_m * factor, sigma_m=sigma_m)
        for r in readings
        if r.distance_m is not None
    ]
    assert bound(weigh(tracks, wrong, stepwise=True), tracks) == set()


@given(scenes(), st.floats(10.0, 1e6))
def test_distances_that_say_nothing_are_as_none(scene, sigma_m) -> None:
    tracks, readings = scene
    vague = [replace(r, facing=Facing.FRONT, sigma_m=sigma_m if r.distance_m else None) for r in readings]
    assert bound(weigh(tracks, vague, stepwise=True), tracks) == set()


@given(scenes(), st.lists(st.integers(0, LAST_MS), min_size=50, max_size=400))
def test_a_storm_of_readings_is_held_within_bounds(scene, times) -> None:
    tracks, _ = scene
    storm = [Sighting(at, at, "", i % 7, Facing.FRONT, -50.0, 2.0 + i % 3, 0.3) for i, at in enumerate(times)]
    assert weigh(tracks, storm).held_count <= LAST_MS // 100 + 1


def weigh_by_frames(
    tracks: list[Track], readings: list[Sighting], unfollowed: dict[int, list[float]], late: list[int]
) -> Matcher:
    """Play frames at 10 Hz, some with somebody in view who is not followed; each reading comes so many frames late."""
    arrivals = [(reading.middle_ms + 100 * n, reading) for reading, n in zip(readings, late, strict=True)]
    waiting = sorted(arrivals, key=lambda arrival: arrival[0])
    matcher = Matcher()
    for one in tracks:
        matcher.add_track(one)
    for at_ms in range(0, LAST_MS + 100, 100):
        while waiting and waiting[0][0] <= at_ms:
            matcher.add_sighting("tag", waiting.pop(0)[1])
        if at_ms in unfollowed:
            matcher.note_unfollowed(at_ms, unfollowed[at_ms])
        matcher.advance(at_ms)
    for _, reading in waiting:
        matcher.add_sighting("tag", reading)
    matcher.advance(LAST_MS)
    return matcher


clouded_frames = st.dictionaries(
    st.integers(0, LAST_MS // 100).map(lambda n: 100 * n), st.lists(range_m, min_size=1, max_size=3), max_size=40
)


@given(scenes(), clouded_frames, st.data())
def test_a_reading_beside_somebody_unfollowed_counts_the_same_in_time_and_late(scene, unfollowed, data) -> None:
    tracks, readings = scene
    late = data.draw(st.lists(st.integers(0, 30), min_size=len(readings), max_size=len(readings)))
    in_time = weigh_by_frames(tracks, readings, unfollowed, [0] * len(readings))
    delayed = weigh_by_frames(tracks, readings, unfollowed, late)
    assert delayed.log_odds("tag") == in_time.log_odds("tag")
    assert bound(delayed, tracks) == bound(in_time, tracks)


@given(scenes())
def test_while_people_at_all_ranges_are_not_followed_nothing_is_bound(scene) -> None:
    tracks, readings = scene
    always = {at_ms: [1.0, 2.5, 4.0, 5.0] for at_ms in range(0, LAST_MS + 100, 100)}
    assert bound(weigh_by_frames(tracks, readings, always, [0] * len(readings)), tracks) == set()
