"""Plays a drive through the robot's redactor, and through its moving hider alone with everybody in turn as the owner."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import BUFFER_DEFAULT_MS, FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.hider import AskedLater, FoundPeople
from clients.robot.hiding.moving.moving_hider import ODOMETRY, DrivingCamera, MovingHider
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.sensing.antenna_pairs import AntennaPair
from clients.robot.sensing.sensor_events import Depth, Frame, Mask, Odometry, Sighting
from clients.robot.synthetic.camera import Labels
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer, DriveTruth
from clients.robot.synthetic.scenario_bag import drive_odometry
from clients.sdk.pictures.rendition_picture import decode_depth_png
from network.lab.hiding.moving.samples import depth_of, mount_of
from network.lab.hiding.run_scene import VISIBLE_MIN_PX, gap_px, placed
from network.lab.hiding.scenes import sightings

EMPTY_FRAMES_COUNT = 8
RANGE_M, APART_M = (1.0, 5.0), 1.0
CHILD_MAX_M = 1.35
DRIVING_MPS, DRIVING_RADPS = 0.02, 0.02
OBSTACLES = ("occluded", "contact")  # somebody or something is before or beside who could be shown
NOT_FOUND = "not-found"  # no body, or one with a wall, furniture or somebody else


@dataclass(frozen=True, slots=True)
class PersonFrame:
    """A person in a frame: metres away, metres to the next person, whether wholly between the picture's sides."""

    number: int
    sequence: int
    away_m: float
    apart_m: float
    whole: bool
    driving: bool
    tagged: bool
    aid: str

    @property
    def counts(self) -> bool:
        """In range, and apart from others."""
        return RANGE_M[0] <= self.away_m <= RANGE_M[1] and self.apart_m > APART_M


@dataclass(slots=True)
class Shown:
    """What pictures showed. `kept`: (person, frame); `things`: pictures of nobody; `wrong`: of another than their owner.

    `foreign_share`: the largest share of anybody else's visible pixels in one picture.
    """

    kept: set[tuple[int, int]] = field(default_factory=set)
    things: int = 0
    wrong: int = 0
    foreign_share: float = 0.0
    foreign_px: int = 0
    owner_shares: list[float] = field(default_factory=list)

    def add(self, shown: Labels, truth: DriveTruth, owner: int | None, sequence: int) -> None:
        """`shown`: whom the pixels of a picture show; `owner`: whose it is to be, None: of whom it shows most."""
        counts, visible = (np.bincount(part.ravel(), minlength=2) for part in (shown, whom(truth)[truth.depth > 0]))
        most = int(counts[1:].argmax()) + 1
        number = most if owner is None else owner
        others = [other for other in np.flatnonzero(counts) if other not in (0, number)]
        self.foreign_px = max([self.foreign_px, *(int(counts[other]) for other in others)])
        self.foreign_share = max([self.foreign_share, *(float(counts[other] / visible[other]) for other in others)])
        if 2 * int(counts[most]) <= shown.size:
            self.things += 1
        elif most != number:
            self.wrong += 1
        else:
            self.kept.add((number, sequence))
            self.owner_shares.append(float(counts[most] / visible[most]))


@dataclass(frozen=True, slots=True, eq=False)
class Rendition:
    """One person, cut out by the moving hider. `released`: else only an obstacle withheld it.

    `gap_px`: to the next person in view, infinite without one.
    """

    sequence: int
    number: int
    cutout: EncodedCutout
    released: bool
    gap_px: float


@dataclass(slots=True)
class DrivePlayed:
    """`end_to_end`: by the redactor, of owners; `everybody`: by the moving hider, with each person as the owner."""

    stratum: str
    seed: int
    people: list[PersonFrame] = field(default_factory=list)
    end_to_end: Shown = field(default_factory=Shown)
    everybody: Shown = field(default_factory=Shown)
    withheld: dict[tuple[int, int], str] = field(default_factory=dict)
    withheld_everybody: dict[tuple[int, int], str] = field(default_factory=dict)
    frame_ms: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """What was cut out of a frame, and whom its pixels show."""

    sequence: int
    cutout: EncodedCutout
    shown: Labels
    withhold_reason: str
    may_show: Callable[[], bool]

    @property
    def number(self) -> int | None:
        """Of the person whom most of it shows, None if it shows nobody."""
        counts = np.bincount(self.shown, minlength=2)
        most = int(counts[1:].argmax()) + 1
        return most if 2 * int(counts[most]) > self.shown.size else None


@dataclass(frozen=True, slots=True)
class _Found:
    """Level place before the camera of somebody whom the hider found, and why it does not show them then."""

    right_m: float
    ahead_m: float
    withhold_reason: str
    later: AskedLater

    def why_not(self) -> str:
        return self.withhold_reason or self.later.why_not()


def run_drive(drive: Drive, seed: int, antenna_pairs: Sequence[AntennaPair] = ()) -> DrivePlayed:
    """Everybody's pictures are judged over the whole drive, owners' in all frames; times are the moving hider's."""
    renderer, played = DriveRenderer(drive), DrivePlayed(drive.stratum, seed)
    redactor, motion = _redactor_of(drive, antenna_pairs), OwnMotion()
    hider = hider_of(drive, motion)
    heard = [(at_ms, (alias, sighting)) for at_ms, alias, sighting in sightings(drive.readings())]
    waiting: list[tuple[int, Odometry | tuple[str, Sighting]]] = [*heard, *drive_odometry(drive, 0)]
    waiting.sort(key=lambda event: event[0], reverse=True)
    truths: dict[int, DriveTruth] = {}
    outputs: list[Output] = []
    candidates: list[Candidate] = []
    seen: dict[int, list[_Found]] = {}

    def push_until(at_ms: float) -> None:
        while waiting and waiting[-1][0] <= at_ms:
            event = waiting.pop()[1]
            if isinstance(event, Odometry):
                redactor.push_odometry(event)
                motion.add(RobotPlace.of_camera(event, 0.0, 0.0))
            else:
                outputs.extend(redactor.push_sighting(*event))

    for index in range(drive.scenario.frame_count):
        truth, at_ms = renderer.truth(index), at_ms_of(drive, index)
        truths[index] = truth
        played.people += _people_in(drive, index, truth)
        push_until(at_ms)
        outputs += redactor.push_frame(Frame(at_ms, index, truth.depth))
        candidates += _look(hider, motion.place_at(at_ms), drive, truth, index, played.frame_ms, seen)
    push_until(math.inf)
    outputs += redactor.flush()
    for candidate in candidates:
        if candidate.may_show():
            played.everybody.add(candidate.shown, truths[candidate.sequence], None, candidate.sequence)
    played.withheld_everybody = _why_not(drive, played, seen)
    for output in outputs:
        if isinstance(output, KeptFrame):
            truth = truths[output.sequence]
            shown = whom(truth)[placed(output, truth.depth.shape) > 0]
            played.end_to_end.add(shown, truth, drive.owners[output.alias], output.sequence)
        elif isinstance(output, WithheldFrame):
            played.withheld[drive.owners[output.alias], output.sequence] = str(output.reason)
    return played


def whom(truth: DriveTruth) -> Labels:
    """Return whom each pixel shows, also by a mirror."""
    return np.where(truth.labels > 0, truth.labels, truth.reflections)


def hider_of(drive: Drive, motion: OwnMotion) -> MovingHider:
    scenario = drive.scenario
    return MovingHider(
        (scenario.height, scenario.width),
        scenario.focal_px,
        mount_of(drive),
        buffer_ms=BUFFER_DEFAULT_MS,
        motion=motion,
    )


def at_ms_of(drive: Drive, index: int) -> int:
    return round(index * 1000 / drive.scenario.frame_rate)


def watch(drive: Drive, frames: range | None = None) -> Iterator[tuple[int, DriveTruth, FoundPeople | None]]:
    """Yield what the moving hider finds, frame by frame; it sees no others than `frames`."""
    renderer, motion = DriveRenderer(drive), OwnMotion()
    hider, waiting = hider_of(drive, motion), drive_odometry(drive, 0)[::-1]
    for index in frames or range(drive.scenario.frame_count):
        at_ms = at_ms_of(drive, index)
        while waiting and waiting[-1][0] <= at_ms:
            motion.add(RobotPlace.of_camera(waiting.pop()[1], 0.0, 0.0))
        truth = renderer.truth(index)
        yield index, truth, hider.find_people(depth_of(drive, truth), motion.place_at(at_ms), at_ms)


def show_everybody(drive: Drive) -> list[Rendition]:
    """Return what the moving hider alone makes of a whole drive."""
    truths: dict[int, DriveTruth] = {}
    candidates: list[Candidate] = []
    for index, truth, found in watch(drive):
        truths[index] = truth
        if found is not None:
            shown = [one for one in found.silhouettes if not one.withhold_reason or one.withhold_reason in OBSTACLES]
            candidates += [cut_out(found, one, truth, index) for one in shown]
    return _renditions(candidates, truths)


def cut_out(found: FoundPeople, silhouette: Silhouette, truth: DriveTruth, index: int) -> Candidate:
    return _candidate(found, silhouette, found.cut(silhouette), truth, index)


def _candidate(
    found: FoundPeople, silhouette: Silhouette, out: EncodedCutout, truth: DriveTruth, index: int
) -> Candidate:
    pixels: Depth = decode_depth_png(out.pixels_png)
    box = whom(truth)[out.y : out.y + out.height, out.x : out.x + out.width]
    return Candidate(index, out, box[pixels > 0], silhouette.withhold_reason, found.may_show[silhouette.label])


def others_of(truth: DriveTruth, number: int) -> Mask:
    """Return where anybody else is to be seen, also by a mirror."""
    shown = whom(truth)
    return np.asarray((shown > 0) & (shown != number), dtype=bool)


def _renditions(candidates: Sequence[Candidate], truths: Mapping[int, DriveTruth]) -> list[Rendition]:
    made = []
    for one in candidates:
        number = one.number
        if number is None or not one.may_show():
            continue
        truth = truths[one.sequence]
        others, gap = others_of(truth, number), math.inf
        if np.count_nonzero(others) >= VISIBLE_MIN_PX:
            gap = gap_px((truth.labels == number)[::2, ::2], others[::2, ::2])
        made.append(Rendition(one.sequence, number, one.cutout, not one.withhold_reason, gap))
    return made


def _look(
    hider: MovingHider,
    place: RobotPlace | None,
    drive: Drive,
    truth: DriveTruth,
    index: int,
    frame_ms: list[float],
    seen: dict[int, list[_Found]],
) -> list[Candidate]:
    """Return what may be shown; `seen` takes up who is found at all, by frame."""
    began = time.thread_time()
    depth = depth_of(drive, truth)
    found = hider.find_people(depth, place, at_ms_of(drive, index))
    if found is None:
        return []
    cutouts = [(one, found.cut(one)) for one in found.silhouettes if not one.withhold_reason]
    frame_ms.append(1000 * (time.thread_time() - began))
    seen[index] = [
        _Found(one.right_m, one.ahead_m, one.withhold_reason, found.may_show[one.label]) for one in found.silhouettes
    ]
    return [_candidate(found, one, out, truth, index) for one, out in cutouts]


def _why_not(drive: Drive, played: DrivePlayed, seen: dict[int, list[_Found]]) -> dict[tuple[int, int], str]:
    """By (person, frame) that counts and is not kept."""
    reasons = {}
    for one in played.people:
        if not one.counts or not one.whole or (one.number, one.sequence) in played.everybody.kept:
            continue
        person = drive.scenario.people[one.number - 1]
        place = drive.seen_from_robot(person, one.sequence / drive.scenario.frame_rate)
        assert place is not None
        away = [
            (math.hypot(body.right_m - place[0], body.ahead_m - place[2]), body) for body in seen.get(one.sequence, [])
        ]
        nearest = [body for away_m, body in sorted(away, key=itemgetter(0)) if away_m <= APART_M / 2]
        reason = (nearest[0].why_not() if nearest else "") or NOT_FOUND
        reasons[one.number, one.sequence] = reason if one.sequence in seen else ODOMETRY
    return reasons


def _redactor_of(drive: Drive, antenna_pairs: Sequence[AntennaPair]) -> FrameRedactor:
    """The robot knows the scene from where it starts."""
    renderer = DriveRenderer(drive)
    return FrameRedactor(
        learn_background([renderer.empty_frame(number) for number in range(1, EMPTY_FRAMES_COUNT + 1)]),
        driving=DrivingCamera(mount_of(drive)),
        time_of_flight=drive.time_of_flight,
        focal_px=drive.scenario.focal_px,
        antenna_pairs=antenna_pairs,
    )


def _people_in(drive: Drive, index: int, truth: DriveTruth) -> list[PersonFrame]:
    at_s = index / drive.scenario.frame_rate
    speed, turn = drive.speeds(at_s)
    driving = abs(speed) > DRIVING_MPS or abs(turn) > DRIVING_RADPS
    people = list(enumerate(drive.scenario.people, start=1))
    places = {number: person.place(at_s) for number, person in people}
    visible = np.bincount(truth.labels.ravel(), minlength=len(people) + 1)
    found = []
    for number, person in people:
        place = places[number]
        if place is None or visible[number] < VISIBLE_MIN_PX:
            continue
        others = [other for name, other in places.items() if name != number and other is not None]
        columns = np.flatnonzero((truth.labels == number).any(axis=0))
        made = PersonFrame(
            number=number,
            sequence=index,
            away_m=math.hypot(place[0] - truth.pose.x, place[1] - truth.pose.z),
            apart_m=min((math.dist(place, other) for other in others), default=math.inf),
            whole=bool(columns[0] > 1 and columns[-1] < truth.labels.shape[1] - 2),
            driving=driving,
            tagged=person.tagged,
            aid=person.aid or ("child" if person.height_m < CHILD_MAX_M else ""),
        )
        found.append(made)
    return found
