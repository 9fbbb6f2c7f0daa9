"""The judge of a robot that drives: what it counts, its bounds, and one drive through everything."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from clients.robot.synthetic.camera import CameraPose
from clients.robot.synthetic.driving.draws import DriveStratum, draw_drive
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveTruth
from clients.robot.synthetic.driving.odometry import FAULTS, Fault, fault_window
from network.lab.hiding.moving.drive_figures import summarise_drives
from network.lab.hiding.moving.run_drive import DrivePlayed, PersonFrame, Shown, run_drive
from network.lab.hiding.scenes import with_antennas
from network.lab.hiding.scoring import upper_bound


def truth_of(labels: list[list[int]], reflections: list[list[int]] | None = None) -> DriveTruth:
    seen = np.array(labels, dtype=np.uint8)
    none = np.zeros_like(seen)
    mirrored = none if reflections is None else np.array(reflections, dtype=np.uint8)
    depth = np.full(seen.shape, 2_000, dtype=np.uint16)
    return DriveTruth(depth, seen, none, none, mirrored, CameraPose(0, 0, 1.2, 0))


def test_every_pixel_of_anybody_else_counts_as_a_share_of_what_was_to_be_seen_of_them() -> None:
    shown = Shown()
    shown.add(np.array([1, 1, 1, 2], dtype=np.uint8), truth_of([[1, 1, 1, 1], [2, 2, 0, 0]]), 1, 7)
    assert shown.kept == {(1, 7)}
    assert (shown.foreign_px, shown.foreign_share) == (1, 0.5)
    assert shown.owner_shares == [0.75]


def test_a_picture_of_another_is_wrong_and_one_of_nobody_is_a_thing() -> None:
    shown = Shown()
    truth = truth_of([[1, 1, 2, 2]])
    shown.add(np.array([2, 2, 0], dtype=np.uint8), truth, 1, 0)
    shown.add(np.array([0, 0, 1], dtype=np.uint8), truth, 1, 1)
    assert (shown.wrong, shown.things) == (1, 1)
    assert not shown.kept


def test_a_picture_in_which_nobody_has_the_most_leaks_all_the_same() -> None:
    shown = Shown()
    shown.add(np.array([1, 1, 2, 2, 0], dtype=np.uint8), truth_of([[1, 1, 2, 2, 0]]), 1, 0)
    assert (shown.things, shown.foreign_px, shown.foreign_share) == (1, 2, 1.0)


def test_who_is_shown_by_a_mirror_is_shown() -> None:
    truth = truth_of([[0, 0, 1, 1]], [[2, 2, 0, 0]])
    shown = Shown()
    shown.add(np.array([2, 2], dtype=np.uint8), truth, 1, 0)
    assert shown.wrong == 1


@pytest.mark.parametrize(("count", "total", "bound"), [(0, 300, 0.0099), (0, 40, 0.0722), (1, 40, 0.1132), (3, 3, 1.0)])
def test_bounds_are_by_scene(count: int, total: int, bound: float) -> None:
    assert upper_bound(count, total) == pytest.approx(bound, abs=2e-4)


def test_shares_are_of_frames_that_count_and_goals_follow_from_them() -> None:
    played = DrivePlayed("straight", 1, frame_ms=[5.0, 6.0, 30.0])
    for sequence in range(10):
        played.people.append(PersonFrame(1, sequence, 3.0, 2.0, True, sequence >= 2, True, ""))
        played.people.append(PersonFrame(2, sequence, 7.0, 2.0, True, True, True, ""))  # out of range
    played.everybody.kept = {(1, sequence) for sequence in range(4, 10)}
    played.end_to_end.kept = {(1, sequence) for sequence in range(6, 10)}
    played.withheld = {(1, sequence): "moved" for sequence in range(6)}
    played.withheld_everybody = {(1, sequence): "contact" for sequence in range(4)}
    figures = summarise_drives([played])
    assert (figures.kept, figures.kept_end_to_end, figures.kept_standing) == (0.75, 0.5, 0.0)
    assert figures.withheld == {"moved": 4}
    assert figures.withheld_by_reason == {"all": {"contact": 0.25}, "none": {"contact": 0.25}}
    assert (figures.frame_ms, figures.frame_p95_ms) == (6.0, 30.0)
    assert figures.goals["no scene shows anybody else"]
    assert not figures.goals["frame_p95_ms <= 15"]
    played.everybody.foreign_share = 0.002
    assert not summarise_drives([played]).goals["no scene shows anybody else"]


def test_a_drive_goes_through_redactor_and_hider() -> None:
    played = run_drive(draw_drive(3, "past", judging=False, stands_s=0.0), 3)
    assert len({frame.sequence for frame in played.people}) > 20
    assert played.everybody.kept
    counted = {(frame.number, frame.sequence) for frame in played.people if frame.counts and frame.whole}
    assert set(played.withheld_everybody) == counted - played.everybody.kept, "each has a reason"
    assert played.everybody.foreign_share <= 0.001
    assert played.end_to_end.wrong == 0
    assert len(played.frame_ms) > 30


def test_an_antenna_that_looks_to_a_side_hears_better_who_is_there_wherever_the_robot_has_turned() -> None:
    drive = draw_drive(3, "turn", judging=False, stands_s=0.0)
    drive = replace(drive, scenario=with_antennas(drive.scenario, 2))
    people = {person.alias: person for person in drive.scenario.people}
    heard: dict[tuple[int, bool], list[float]] = {}
    for reading in drive.readings():
        place = drive.seen_from_robot(people[reading.alias], reading.at_s)
        assert place is not None
        bearing_deg = math.degrees(math.atan2(place[0], place[2]))
        if 15 < abs(bearing_deg) < 90:
            heard.setdefault((reading.antenna, bearing_deg > 0), []).append(reading.rssi_dbm)
    left, right = 1, 2
    assert np.mean(heard[right, True]) > np.mean(heard[left, True])
    assert np.mean(heard[left, False]) > np.mean(heard[right, False])


@pytest.mark.long
@pytest.mark.parametrize("faults", [(), *((fault,) for fault in FAULTS), FAULTS], ids="-".join)
@pytest.mark.parametrize(("stratum", "seed"), [("past", 2), ("crowd", 1)])
def test_whatever_the_odometry_says_nobody_else_is_shown(
    stratum: DriveStratum, seed: int, faults: tuple[Fault, ...]
) -> None:
    drive = draw_drive(seed, stratum, judging=False, stands_s=8.0)
    played = run_drive(replace(drive, faults=faults), seed)
    shown = played.end_to_end
    assert (shown.wrong, shown.things) == (0, 0)
    assert shown.foreign_share <= 0.001
    if stratum == "past" and not faults:
        assert len(shown.kept) > 60, "there is somebody to lose"
    if "jump" in faults:
        begin_s, _ = fault_window(drive.scenario.seed, "jump", drive.scenario.frame_count / drive.scenario.frame_rate)
        late = [sequence for _, sequence in shown.kept if sequence > (begin_s + 1) * drive.scenario.frame_rate]
        assert not late, "after a jump nobody is known, and on the way nobody is bound again"


@dataclass(frozen=True, slots=True)
class KnockedDrive(Drive):
    """Halfway somebody knocks against the camera, which looks elsewhere from then on."""

    knocked_pitch: float = 0.0
    knocked_roll: float = 0.0

    @property
    def knocked_s(self) -> float:
        return 8.0 + (self.scenario.frame_count / self.scenario.frame_rate - 8.0) / 2

    def camera_pose(self, at_s: float) -> CameraPose:
        pose = Drive.camera_pose(self, at_s)
        if at_s < self.knocked_s:
            return pose
        return replace(pose, pitch=pose.pitch + self.knocked_pitch, roll=pose.roll + self.knocked_roll)


@pytest.mark.long
@pytest.mark.parametrize("faults", [(), FAULTS], ids=["honest", "all-faults"])
@pytest.mark.parametrize(("pitch", "roll"), [(math.radians(15), 0.0), (0.0, math.radians(15)), (math.radians(3), 0.0)])
def test_a_camera_that_is_knocked_askew_on_the_way_shows_nobody_else(
    pitch: float, roll: float, faults: tuple[Fault, ...]
) -> None:
    drawn = replace(draw_drive(2, "past", judging=False, stands_s=8.0), faults=faults)
    drive = KnockedDrive(
        **{part.name: getattr(drawn, part.name) for part in fields(drawn)}, knocked_pitch=pitch, knocked_roll=roll
    )
    played = run_drive(drive, 2)
    for shown in (played.end_to_end, played.everybody):
        assert shown.wrong == 0
        assert shown.foreign_share <= 0.001
    last = max(frame.sequence for frame in played.people)
    late = [sequence for _, sequence in played.everybody.kept if sequence > drive.knocked_s * drive.scenario.frame_rate]
    if pitch > math.radians(4):
        assert not [sequence for sequence in late if sequence > last - 5], "where the floor is lost, so is everybody"
    elif not faults:
        assert late, "a camera that is a little askew finds the floor again"
