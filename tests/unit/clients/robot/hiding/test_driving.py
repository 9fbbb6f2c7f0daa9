"""A robot that drives: who is bound while it stands stays known, nobody is bound on the way, and doubt ends that."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.hider import AskedLater, FoundPeople, in_odometry
from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.moving_hider import DrivingCamera
from clients.robot.hiding.moving.release_rule import Doubt
from clients.robot.hiding.own_motion import FOLLOWED_M, SPOT_M, Home, OwnMotion, RobotPlace
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.standing_readings import UNKNOWN_MAX_MS, StandingReadings
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_events import Depth, Facing, Frame, Odometry, Sighting

SHAPE = (60, 80)
FRAME_MS, ODOMETRY_MS, READING_MS = 100, 50, 500
DRIVES_MS, ENDS_MS = 10_000, 18_000
SPEED_MPS = 0.4
EMPTY = np.full(SHAPE, 3_000, np.uint16)


@dataclass(frozen=True)
class _Later(AskedLater):
    reason: str

    def why_not(self) -> str:
        return self.reason


class ScriptedHider:
    """Finds people at places of the world, as the camera would from where the robot truly is."""

    def __init__(self, ward: Ward, *, is_blank: bool) -> None:
        self._ward = ward
        self.is_blank = is_blank

    def find_people(self, depth: Depth, place: RobotPlace | None, at_ms: int) -> FoundPeople | None:
        fits = at_ms < DRIVES_MS or self._ward.fits_everywhere
        if (self.is_blank and place is None) or (not self.is_blank and not fits):
            return None
        found = []
        people = [] if at_ms in self._ward.hidden_ms else self._ward.people(at_ms)
        for label, (x_m, z_m) in enumerate(people, start=1):
            ahead_m = z_m - self._ward.true_z(at_ms)
            one = Silhouette(
                label,
                (0, 0, 1, 1),
                x_m,
                ahead_m,
                math.hypot(x_m, ahead_m),
                round(ahead_m * 1000),
                "",
                ahead_m=ahead_m,
                right_m=x_m,
            )
            found.append(one if place is None else in_odometry(one, place))
        later = _Later(self._ward.why_not)
        may_show: dict[int, AskedLater] = {one.label: later for one in found} if self.is_blank else {}
        return FoundPeople(tuple(found), False, lambda one: EncodedCutout(one.label, 0, 1, 1, b""), may_show)

    def restart(self) -> None: ...


def true_z(at_ms: int) -> float:
    return SPEED_MPS * max(0, at_ms - DRIVES_MS) / 1000


class Ward:
    """One tagged person (the first) and others; odometry may be spoilt. A picture's box begins at its person's number."""

    def __init__(self) -> None:
        self.people: Callable[[int], list[tuple[float, float]]] = lambda _: [(0.2, 3.5)]
        self.true_z: Callable[[int], float] = true_z
        self.odometry: Callable[[int], Odometry | None] = lambda at_ms: Odometry(at_ms, self.true_z(at_ms), 0.0, 0.0)
        self.facing = Facing.FRONT
        self.odometry_late_ms = 0
        self.fits_everywhere = False
        self.keeps = True
        self.mount: Ground | None = Ground.of_mount(1.2, 0.0)
        self.heard_from_ms = 0
        self.heard_ms: frozenset[int] | None = None  # only then; None: twice a second
        self.hidden_ms = range(0)
        self.confirms = False  # whether the camera agrees with the odometry also away from the empty scene
        self.why_not = ""  # is not shown in the end who was found without the empty scene
        self.outputs: list[Output] = []

    def play(self) -> Ward:
        camera = DrivingCamera(self.mount, keeps=self.keeps)
        redactor = FrameRedactor(learn_background([EMPTY] * 3), driving=camera)
        blank = [ScriptedHider(self, is_blank=True)] if self.keeps and self.mount is not None else []
        redactor._hiders = [ScriptedHider(self, is_blank=False), *blank]
        redactor._second_look = None  # it would look into the frames, and in these is nobody
        for at_ms in range(0, ENDS_MS, ODOMETRY_MS):
            place = self.odometry(at_ms - self.odometry_late_ms)
            if place is not None:
                redactor.push_odometry(place)
            heard = at_ms % READING_MS == 0 if self.heard_ms is None else at_ms in self.heard_ms
            if heard and at_ms >= self.heard_from_ms:
                x_m, z_m = self.people(at_ms)[0]
                distance_m = math.hypot(x_m, z_m - self.true_z(at_ms))
                reading = Sighting(at_ms, at_ms, "", 1, self.facing, -50.0, distance_m, 0.2)
                self.outputs += redactor.push_sighting("owner", reading)
            if at_ms % FRAME_MS == 0:
                self.outputs += redactor.push_frame(Frame(at_ms, at_ms // FRAME_MS, EMPTY))
                if self.confirms and redactor._motion is not None:
                    redactor._motion.confirm(at_ms)
        self.outputs += redactor.flush()
        self.figures = redactor.summarise_driving()
        return self

    def kept(self, *, blank: bool) -> list[KeptFrame]:
        return [one for one in self.outputs if isinstance(one, KeptFrame) and one.blank == blank]

    def withheld(self, from_ms: int = 0) -> Counter[str]:
        found = [one for one in self.outputs if isinstance(one, WithheldFrame) and one.captured_at_ms >= from_ms]
        return Counter(str(one.reason) for one in found)


DRIVING_COUNT = (ENDS_MS - DRIVES_MS) // FRAME_MS


def test_who_was_known_when_the_robot_stood_is_kept_on_the_way_without_the_room() -> None:
    ward = Ward().play()
    assert len(ward.kept(blank=True)) >= 0.9 * DRIVING_COUNT
    assert all(kept.captured_at_ms >= DRIVES_MS for kept in ward.kept(blank=True))
    assert all(kept.captured_at_ms < DRIVES_MS for kept in ward.kept(blank=False))


def test_nobody_counts_as_alone_on_the_way_where_only_bodies_are_looked_for() -> None:
    """Who is too far, low or broad for a body of one person is not seen there, but heard, and in a whole picture."""
    ward = Ward().play()
    assert ward.kept(blank=True)
    assert ward.kept(blank=False)
    assert not any(kept.alone for kept in ward.kept(blank=True))
    assert all(kept.alone for kept in ward.kept(blank=False))


def test_nobody_is_bound_by_readings_that_came_while_the_robot_drove() -> None:
    ward = Ward()
    ward.heard_from_ms = DRIVES_MS + 1_000
    ward.play()
    assert not ward.kept(blank=True)
    assert set(ward.withheld(DRIVES_MS + 1_000)) == {"moved"}


@pytest.mark.parametrize(
    ("why_not", "told"), [(str(Doubt.HIDDEN), "unverified"), ("unverified", "unverified"), ("merged", "merged")]
)
def test_what_the_hider_does_not_allow_in_the_end_is_withheld(why_not: str, told: str) -> None:
    ward = Ward()
    ward.why_not = why_not
    ward.play()
    assert not ward.kept(blank=True)
    assert ward.withheld(DRIVES_MS)[told] >= 0.9 * DRIVING_COUNT


@pytest.mark.parametrize("keeps", [True, False])
def test_without_the_floor_there_is_no_second_look_and_nothing_is_kept_at_stops_either(*, keeps: bool) -> None:
    """Who does not ask for more is told nothing of a floor."""
    ward = Ward()
    ward.mount, ward.keeps = None, keeps
    ward.play()
    assert bool(ward.kept(blank=False)) == (not keeps)
    assert (ward.withheld()["no-ground"] >= 0.9 * DRIVES_MS // FRAME_MS) == keeps
    assert ward.figures is not None
    assert ward.figures.camera_height_m is None


def test_without_odometry_nothing_is_kept_on_the_way() -> None:
    ward = Ward()
    ward.odometry = lambda _: None
    ward.play()
    assert not ward.kept(blank=True)
    assert not ward.kept(blank=False)
    assert ward.withheld(DRIVES_MS)["moved"] >= 0.9 * DRIVING_COUNT
    assert ward.figures is not None
    assert ward.figures.unplaced_readings >= (ENDS_MS - UNKNOWN_MAX_MS) // READING_MS - 1


@pytest.mark.parametrize("keeps", [True, False])
def test_a_scene_that_seems_to_fit_on_the_way_is_not_taken_for_the_one_that_was_learned(*, keeps: bool) -> None:
    """Driving along a bare corridor changes nothing that a camera sees of it, and all that is nearer seems to be people."""
    ward = Ward()
    ward.fits_everywhere, ward.keeps = True, keeps
    ward.play()
    assert ward.kept(blank=False)
    left_ms = DRIVES_MS + round(1_000 * SPOT_M / SPEED_MPS) + FRAME_MS
    assert all(kept.captured_at_ms <= left_ms for kept in ward.kept(blank=False))
    assert bool(ward.kept(blank=True)) == keeps


def test_a_robot_that_comes_back_to_its_place_hides_before_the_empty_scene_again() -> None:
    ward = Ward()
    ward.fits_everywhere = True
    ward.true_z = lambda at_ms: 0.4 * max(0.0, 1 - abs(at_ms - 13_000) / 2_000)
    ward.play()
    room = [kept.captured_at_ms for kept in ward.kept(blank=False)]
    assert not [at_ms for at_ms in room if 11_500 < at_ms < 14_500]
    assert [at_ms for at_ms in room if at_ms > 16_000]


def test_what_several_places_tell_together_binds_nobody() -> None:
    """From one to the next all distances shrink alike: to a stranger ahead, and to the bearer beside them."""
    stops = [(3_000 * stop + wait, float(stop % 3)) for stop in range(6) for wait in (0, 2_000)]
    ward = Ward()
    ward.fits_everywhere = True
    ward.facing = Facing.UNKNOWN
    ward.people = lambda _: [(0.0, 4.5)]
    ward.true_z = lambda at_ms: float(np.interp(at_ms, *zip(*stops, strict=True)))
    ward.play()
    assert ward.outputs
    assert not ward.kept(blank=True)
    assert not ward.kept(blank=False)


ANEW_MS = 14_000


def stops_away_z(at_ms: int) -> float:
    """1.2 m from home, from a second before `ANEW_MS`."""
    return SPEED_MPS * max(0, min(at_ms, ANEW_MS - 1_000) - DRIVES_MS) / 1_000


@pytest.mark.parametrize("out_ms", [0, 600, 3_000])
def test_odometry_that_begins_anew_on_the_way_makes_no_other_place_home(out_ms: int) -> None:
    def begins_anew(at_ms: int) -> Odometry | None:
        if ANEW_MS - out_ms <= at_ms < ANEW_MS:
            return None
        return Odometry(at_ms, stops_away_z(at_ms) if at_ms < ANEW_MS else 0.0, 0.0, 0.0)

    ward = Ward()
    ward.true_z, ward.odometry, ward.fits_everywhere = stops_away_z, begins_anew, True
    ward.play()
    assert ward.kept(blank=False)
    assert all(kept.captured_at_ms < ANEW_MS for kept in ward.kept(blank=False))


def test_odometry_that_begins_anew_after_a_robot_was_pushed_from_home_makes_no_other_place_home() -> None:
    """It was home when the odometry went out, and by what it tells it is again."""
    ward = Ward()
    ward.true_z = lambda at_ms: 1.2 if at_ms >= DRIVES_MS else 0.0
    ward.odometry = lambda at_ms: None if DRIVES_MS <= at_ms < DRIVES_MS + 3_000 else Odometry(at_ms, 0.0, 0.0, 0.0)
    ward.fits_everywhere = True
    ward.play()
    assert ward.kept(blank=False)
    assert all(kept.captured_at_ms < DRIVES_MS + 3_000 for kept in ward.kept(blank=False))


@pytest.mark.parametrize("spoilt_ms", [range(6_000, 7_500), range(6_050, 6_051)])
def test_a_robot_that_stands_at_home_stays_there_when_its_odometry_falters(spoilt_ms: range) -> None:
    """It goes out for a while, or is elsewhere once."""
    falters = Odometry(spoilt_ms.start, 5.0, 0.0, 0.0) if len(spoilt_ms) == 1 else None
    ward = Ward()
    ward.true_z, ward.fits_everywhere = lambda _: 0.0, True
    ward.odometry = lambda at_ms: falters if at_ms in spoilt_ms else Odometry(at_ms, 0.0, 0.0, 0.0)
    ward.play()
    assert [kept for kept in ward.kept(blank=False) if kept.captured_at_ms > ENDS_MS - 1_000]


def test_home_is_lost_where_the_camera_saw_that_the_odometry_lies_or_its_clock_was_set_back() -> None:
    motion, told = OwnMotion(), [RobotPlace(at_ms) for at_ms in (1_000, 1_500)]
    homes = [Home() for _ in range(4)]
    for home in homes:
        assert home.may_hold(told[0])
        home.fit(told[0])
    homes[0].go_on_after_break(told[1], motion)
    homes[1].go_on_after_break(RobotPlace(1_500, 0.2), motion)
    homes[2].lose()
    motion.doubt(1_100, 1_200)
    homes[3].go_on_after_break(told[1], motion)
    assert [home.may_hold(told[1]) for home in homes] == [True, False, False, False]


def test_back_on_the_first_clock_home_is_not_where_the_scene_fits_next() -> None:
    redactor = FrameRedactor(learn_background([EMPTY] * 3), driving=DrivingCamera(Ground.of_mount(1.2, 0.0)))
    fitted = []
    for at_ms in [*range(0, 100_000, 1_000), *range(10_000, 20_000, 1_000)]:
        redactor.push_odometry(Odometry(at_ms, 0.0, 0.0, 0.0))
        redactor.push_frame(Frame(at_ms, at_ms // 1_000 + 1_000 * len(fitted), EMPTY, received_at_ms=at_ms))
        fitted.append(redactor._home.may_hold(RobotPlace(at_ms)))
    assert fitted[50]
    assert not fitted[-1]


def back_and_forth_z(at_ms: int) -> float:
    """Away by 30 cm, and back again, for two seconds before `DRIVES_MS`."""
    return 0.3 * max(0.0, 1 - abs(at_ms - (DRIVES_MS - 1_000)) / 1_000)


def test_a_robot_that_comes_back_to_its_place_goes_on_with_what_it_heard_there() -> None:
    ward = Ward()
    ward.true_z, ward.fits_everywhere = back_and_forth_z, True
    before, away, after = {6_000, 6_500, 7_000, 7_500}, {8_800}, {11_000, 12_000}
    ward.heard_ms = frozenset(after)
    assert not ward.play().kept(blank=False), "two readings are too few"
    ward = Ward()
    ward.true_z, ward.fits_everywhere = back_and_forth_z, True
    ward.heard_ms = frozenset(before - {6_000, 6_500} | away | after)
    assert ward.play().kept(blank=False)


def creeping_z(at_ms: int) -> float:
    """Some centimetres every second, and still in between."""
    return 0.045 * (at_ms // 1_000 + min(1.0, at_ms % 1_000 / 200))


def test_a_robot_that_creeps_from_stop_to_stop_adds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each step is within a spot, two are not."""
    begun = []
    forget = Matcher.forget_evidence
    monkeypatch.setattr(Matcher, "forget_evidence", lambda matcher: (begun.append(1), forget(matcher)))
    ward = Ward()
    ward.true_z, ward.confirms = creeping_z, True
    ward.heard_ms = frozenset(range(600, ENDS_MS, 1_000))
    ward.play()
    steps = (ENDS_MS - UNKNOWN_MAX_MS) // 1_000
    assert len(begun) >= steps // 2 - 1


def steadily_creeping_z(at_ms: int) -> float:
    """Slower than what counts as standing."""
    return 0.01 * at_ms / 1_000


def test_a_robot_that_creeps_steadily_does_not_take_its_place_along() -> None:
    ward = Ward()
    ward.true_z, ward.fits_everywhere = steadily_creeping_z, True
    ward.play()
    left_ms = round(1_000 * FOLLOWED_M / 0.01)
    assert ward.kept(blank=False)
    assert all(kept.captured_at_ms <= left_ms for kept in ward.kept(blank=False))


@pytest.mark.parametrize(
    ("mps", "degrees_per_s", "right_m", "bearing_sigma_deg"),
    [(0.01, 0.0, 1.7, None), (0.019, 0.0, 1.7, None), (0.0, 0.9, 0.6, 6.0)],
)
def test_a_robot_that_creeps_or_turns_steadily_binds_no_stranger(
    mps: float, degrees_per_s: float, right_m: float, bearing_sigma_deg: float | None
) -> None:
    """Who wears the tag stands beside: distances and bearings of both change alike, by the robot's own motion."""
    times = range(0, 44_000, FRAME_MS)
    came, turned = [mps * at_ms / 1_000 for at_ms in times], [degrees_per_s * at_ms / 1_000 for at_ms in times]
    for seed in range(3):
        rng, motion, matcher = np.random.default_rng(seed), OwnMotion(), Matcher(drives=True)
        for at_ms in range(0, times.stop + 1_000, ODOMETRY_MS):
            motion.add(RobotPlace(at_ms, 0.0, mps * at_ms / 1_000, math.radians(degrees_per_s * at_ms / 1_000)))
        ranges, bearings = [3.0 - z_m for z_m in came], [-yaw for yaw in turned]
        matcher.add_track(Track(1, 0, times[-1], 0.0, 3.0, times=list(times), ranges=ranges, bearings=bearings))
        readings = StandingReadings(motion)
        for at_ms, z_m, yaw in zip(times, came, turned, strict=True):
            distance_m = math.hypot(2.9 - z_m, right_m) + float(rng.normal(0, 0.15))
            bearing_deg = math.degrees(math.atan2(right_m, 2.9 - z_m)) - yaw + float(rng.normal(0, 5.0))
            heard = Sighting(at_ms, at_ms, "", 1, Facing.UNKNOWN, -50.0, distance_m, 0.15)
            if bearing_sigma_deg is not None:
                heard = replace(heard, bearing_deg=bearing_deg, bearing_sigma_deg=bearing_sigma_deg)
            if at_ms % READING_MS == 0:
                readings.push("owner", heard)
            motion.confirm(at_ms)
            readings.weigh(matcher, at_ms)
            matcher.advance(at_ms)
            assert matcher.bound_track("owner", [1]) is None


def test_readings_after_the_odometry_broke_off_wait_no_longer_than_their_time() -> None:
    redactor = FrameRedactor(learn_background([EMPTY] * 3), driving=DrivingCamera(Ground.of_mount(1.2, 0.0)))
    for at_ms in range(0, 20_000, FRAME_MS):
        if at_ms < 1_000:
            redactor.push_odometry(Odometry(at_ms, 0.0, 0.0, 0.0))
        redactor.push_sighting("owner", Sighting(at_ms, at_ms, "", 1, Facing.FRONT, -50.0, 2.0, 0.2))
        redactor.push_frame(Frame(at_ms, at_ms // FRAME_MS, EMPTY))
        assert redactor._readings is not None
        assert redactor._readings.waiting_count <= UNKNOWN_MAX_MS // FRAME_MS + 1


def test_a_gap_in_the_odometry_of_a_robot_that_stands_shows_nobody_elses_picture() -> None:
    """The odometry begins elsewhere, so before the camera another stands where the owner is in its frame."""
    gap = range(5_000, 7_000)
    ward = Ward()
    ward.people = lambda _: [(0.0, 2.5), (0.0, 3.7)]
    ward.odometry = lambda at_ms: None if at_ms in gap else Odometry(at_ms, 1.2 + true_z(at_ms), 0.0, 0.0)
    ward.play()
    assert {kept.cutout.x for kept in ward.kept(blank=False)} == {1}


def test_nobody_is_followed_across_a_gap_in_the_odometry() -> None:
    gap = range(DRIVES_MS + 2_000, DRIVES_MS + 2_600)
    ward = Ward()
    ward.odometry = lambda at_ms: None if at_ms in gap else Odometry(at_ms, true_z(at_ms), 0.0, 0.0)
    ward.play()
    assert ward.kept(blank=True)
    assert ward.kept(blank=True)[-1].captured_at_ms < gap.start + 300
    assert ward.withheld(gap.stop)["moved"] >= 0.9 * (ENDS_MS - gap.stop) // FRAME_MS


def test_one_place_that_is_stamped_far_in_the_future_ends_nothing() -> None:
    ward = Ward()
    ward.odometry = lambda at_ms: Odometry(3_600_000 if at_ms == 4_050 else at_ms, true_z(at_ms), 0.0, 0.0)
    ward.odometry_late_ms = ODOMETRY_MS
    ward.play()
    assert ward.kept(blank=True)[-1].captured_at_ms > ENDS_MS - 1_000


def test_a_short_gap_in_the_odometry_ends_nothing() -> None:
    gap = range(DRIVES_MS + 2_000, DRIVES_MS + 2_200)
    ward = Ward()
    ward.odometry = lambda at_ms: None if at_ms in gap else Odometry(at_ms, true_z(at_ms), 0.0, 0.0)
    ward.play()
    assert ward.kept(blank=True)[-1].captured_at_ms > gap.stop + 1_000


@pytest.mark.parametrize("late_ms", [0, 100, 150])
@pytest.mark.parametrize("jump", [(0.3, 0.0), (1.0, 0.0), (0.0, 1.2)])
def test_after_a_jump_of_the_odometry_nobody_is_known_any_more(jump: tuple[float, float], late_ms: int) -> None:
    """Also if its sample comes after a frame that was placed by the samples before."""
    jumps_ms = DRIVES_MS + 3_000
    left_m, yaw = jump

    def spoilt(at_ms: int) -> Odometry:
        over = at_ms >= jumps_ms
        return Odometry(at_ms, true_z(at_ms), left_m * over, yaw * over)

    ward = Ward()
    ward.odometry = spoilt
    ward.odometry_late_ms = late_ms
    ward.play()
    assert ward.kept(blank=True)
    assert max(kept.captured_at_ms for kept in ward.kept(blank=True)) < jumps_ms + late_ms + FRAME_MS


def test_two_who_could_have_been_exchanged_on_the_way_are_both_withheld_from_then_on() -> None:
    meets_ms = DRIVES_MS + 3_000

    def people(at_ms: int) -> list[tuple[float, float]]:
        if at_ms >= meets_ms:
            return [(0.7, 3.5), (0.9, 3.6)]
        came = max(0, at_ms - DRIVES_MS) / (meets_ms - DRIVES_MS)
        return [(0.2, 3.5), (1.2, 5.0 - 1.4 * came)]

    ward = Ward()
    ward.people = people
    ward.hidden_ms = range(meets_ms, meets_ms + 600)
    ward.play()
    late = [kept for kept in ward.kept(blank=True) if kept.captured_at_ms >= meets_ms + 600]
    assert ward.kept(blank=True)
    assert not late


def test_readings_that_wait_for_odometry_are_held_in_bounded_memory() -> None:
    redactor = FrameRedactor(learn_background([EMPTY] * 3), driving=DrivingCamera(Ground.of_mount(1.2, 0.0)))
    for number in range(10_000):
        heard = Sighting(number, number, "", 1, Facing.FRONT, -50.0, 2.0, 0.2)
        redactor.push_sighting("owner", heard)
    assert redactor._readings is not None
    assert redactor._readings.waiting_count <= 4_096


def test_a_camera_whose_clock_is_set_back_has_no_place_from_before() -> None:
    redactor = FrameRedactor(learn_background([EMPTY] * 3), driving=DrivingCamera(Ground.of_mount(1.2, 0.0)))
    for at_ms in range(0, 100_000, 1_000):
        redactor.push_odometry(Odometry(at_ms, 0.0, 0.0, 0.0))
        redactor.push_frame(Frame(at_ms, at_ms // 1_000, EMPTY, received_at_ms=at_ms))
    assert redactor._placed_by_ms == 99_000
    redactor.push_frame(Frame(10_000, 1_000, EMPTY, received_at_ms=100_000))
    assert redactor._placed_by_ms is None
    assert redactor._motion is not None
    assert redactor._motion.newest_ms is None


@pytest.mark.parametrize("keeps", [True, False])
def test_at_stops_a_robot_that_drives_shows_nobody_who_is_far_whether_it_keeps_people_on_the_way_or_not(
    *, keeps: bool
) -> None:
    far, place = np.full((480, 640), 8_000, np.uint16), RobotPlace(0)
    depth = far.copy()
    depth[159:317, 295:346] = 5_600
    redactor = FrameRedactor(learn_background([far] * 3), driving=DrivingCamera(keeps=keeps))
    found = redactor._hiders[0].find_people(depth, place, 0)
    assert found is not None
    assert [one.withhold_reason for one in found.silhouettes] == ["out-of-range"]
