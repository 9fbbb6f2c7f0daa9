"""Redacts a camera's stream frame by frame, with nobody but the owner in any picture.

Silhouettes are cut out on arrival and whole frames never held; ambiguity means withheld.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from clients.robot.hiding.background import Background
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.flying_pixels import drop_flying_pixels
from clients.robot.hiding.hider import AskedLater, FoundPeople, Hider
from clients.robot.hiding.moving.driving_figures import DrivingFigures
from clients.robot.hiding.moving.ground_plane import Ground, measure_mount
from clients.robot.hiding.moving.moving_hider import DrivingCamera, MovingHider
from clients.robot.hiding.moving.plan_bodies import camera_points
from clients.robot.hiding.own_motion import Home, OwnMotion, RobotPlace
from clients.robot.hiding.standing_hider import StandingHider
from clients.robot.hiding.standing_readings import StandingReadings
from clients.robot.hiding.withhold_reason import MergedEvidence, WithholdReason
from clients.robot.matching.match_evidence import MatchEvidence
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Tracker
from clients.robot.pairing.tag_pairing import LATENESS_DEFAULT_MS, WINDOW_DEFAULT_MS, Decision, Pairing
from clients.robot.sensing.antenna_pairs import AntennaBearings, AntennaPair
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sensing.sensor_events import Depth, Frame, Odometry, Sighting, check_depth
from consensus.errors import BlockRobotError
from consensus.records.renditions import ENCODING_LABEL, ENCODING_PNG16

BUFFER_DEFAULT_MS = 10_000
FORGET_EVERY_MS = 5_000


@dataclass(frozen=True, slots=True)
class SampleForm:
    """A whole sample's size in pixels (sound, labels: 1 x 1), and how what is kept of it is encoded."""

    width: int = 1
    height: int = 1
    encoding: str = ENCODING_LABEL


@dataclass(frozen=True, slots=True)
class KeptFrame:
    """A rendition: the owner's pixels, ready for sealing."""

    sequence: int
    captured_at_ms: int
    alias: str
    cutout: EncodedCutout
    alone: bool = False  # whether nobody else is in the picture, as far as the camera measures depth; blank: not known
    evidence: MatchEvidence | None = None  # only where distances disagree with the camera's all the same
    form: SampleForm | None = None  # None: a depth frame of the camera
    blank: bool = False  # whether it shows the owner on nothing, not in the room


@dataclass(frozen=True, slots=True)
class WithheldFrame:
    """A withheld frame and reason; numbers for `AMBIGUOUS`, `MERGED`."""

    sequence: int
    captured_at_ms: int
    alias: str
    reason: WithholdReason
    evidence: MatchEvidence | MergedEvidence | None = None


Output = Decision | KeptFrame | WithheldFrame


@dataclass(slots=True)
class _Seen:
    sequence: int
    captured_at_ms: int
    cutouts: dict[int, EncodedCutout] = field(default_factory=dict)
    withhold_reasons: dict[int, str] = field(default_factory=dict)
    merged: bool = False
    company: MergedEvidence | None = None  # of the merged silhouette that is nearest to being one person
    stray: bool = False  # more than noise is nearer than the empty scene and belongs to no silhouette
    disordered: bool = False
    moved: bool = False
    blank: bool = False
    may_show: dict[int, AskedLater] = field(default_factory=dict)

    @property
    def tracks(self) -> tuple[int, ...]:
        return (*self.cutouts, *self.withhold_reasons)


class FrameRedactor:
    """Pairs, segments, tracks, matches and cuts. Not thread-safe. Calls return settled outputs: each frame's `Decision`
    once, then `KeptFrame` or `WithheldFrame` per owner.

    With a `driving` camera, odometry has to say where the robot is. It hides before the empty scene only at the place where
    that fitted first, and elsewhere without it, or not at all. Tags are bound while the robot stands, at each place anew;
    while it drives, only people whom it knew before are kept. Who looks like two people without the empty
    scene is not shown before it either. `time_of_flight`: how the camera measures; what it sees
    between two surfaces is dropped first. `antenna_pairs` give readings bearings.
    """

    def __init__(
        self,
        background: Background,
        *,
        driving: DrivingCamera | None = None,
        time_of_flight: bool = False,
        antenna_pairs: Sequence[AntennaPair] = (),
        focal_px: float = FOCAL_DEFAULT_PX,
        window_ms: int = WINDOW_DEFAULT_MS,
        lateness_ms: int = LATENESS_DEFAULT_MS,
        buffer_ms: int = BUFFER_DEFAULT_MS,
    ) -> None:
        self.pairing = Pairing(window_ms, lateness_ms)
        self.matcher = Matcher(drives=driving is not None)
        self._background = background
        self._driving = driving
        self._time_of_flight = time_of_flight
        self._bearings = AntennaBearings(antenna_pairs)
        self._buffer_ms = max(buffer_ms, window_ms + lateness_ms + 1)
        self._tracker = Tracker()
        self._motion = OwnMotion() if driving is not None else None
        self._readings = StandingReadings(self._motion) if self._motion is not None else None
        self._mount: Ground | None = None
        self._blank_frames_count = 0
        self._blank_kept_count = 0
        self.use_focal_px(focal_px)
        self._seen: dict[int, _Seen] = {}
        self._pending: dict[str, deque[_Seen]] = {}
        self._newest_ms: int | None = None
        self._home = Home()
        self._placed_by_ms: int | None = None  # the newest sample by which a frame was placed: a jump may come late
        self._forgot_ms = 0

    def use_focal_px(self, focal_px: float) -> None:
        drives = self._driving is not None
        self._hiders: list[Hider] = [StandingHider(self._background, focal_px, drives=drives)]
        self._second_look: MovingHider | None = None
        if self._driving is not None and self._driving.keeps:
            self._mount = self._driving.mount or measure_mount(camera_points(self._background.depth, focal_px))
        if self._mount is not None and self._motion is not None:
            self._second_look = MovingHider(
                self._background.shape,
                focal_px,
                self._mount,
                buffer_ms=self._buffer_ms,
                motion=self._motion,
                sides=self._background.sides,
            )
            self._hiders.append(self._second_look)

    def push_odometry(self, odometry: Odometry) -> None:
        """Dropped if the robot is not one that drives. In any order."""
        if self._motion is not None and self._driving is not None:
            self._motion.add(RobotPlace.of_camera(odometry, self._driving.ahead_m, self._driving.left_m))

    def summarise_driving(self) -> DrivingFigures | None:
        """None if the robot is not one that drives."""
        if self._motion is None or self._readings is None or self._driving is None:
            return None
        mount = self._mount
        return DrivingFigures(
            keep=self._driving.keeps,
            places=self._motion.places_count,
            doubts=self._motion.doubts_count,
            home_lost=self._home.is_lost,
            frames=self._blank_frames_count,
            kept=self._blank_kept_count,
            unplaced_readings=self._readings.unplaced_count,
            camera_height_m=None if mount is None else round(mount.height_m, 2),
            camera_pitch_deg=None if mount is None else round(math.degrees(mount.pitch), 1),
        )

    @property
    def form(self) -> SampleForm:
        height, width = self._background.shape
        return SampleForm(width, height, ENCODING_PNG16)

    @property
    def held_count(self) -> int:
        """Number of undecided frames with cuts in memory."""
        waiting = {seen.sequence for queue in self._pending.values() for seen in queue}
        return len(waiting | self._seen.keys())

    def push_sighting(self, alias: str, sighting: Sighting, *, known: bool = True) -> list[Output]:
        """Add a sighting of tag `alias`, weighed at the next frame; `known`: on the roster."""
        outputs = self.cover(alias, sighting, known=known)
        sighting = self._bearings.locate(alias, sighting)
        if self._readings is None:
            self.matcher.add_sighting(alias, sighting, known=known)
        else:
            self._readings.push(alias, sighting, known=known)
        return outputs

    def cover(self, alias: str, sighting: Sighting, *, known: bool = True) -> list[Output]:
        """For pairing only."""
        received_ms = sighting.received_at_ms
        first_ms, last_ms = sighting.first_seen_ms, sighting.last_seen_ms
        decided = self.pairing.add_sighting(alias, first_ms, last_ms, known=known, received_at_ms=received_ms)
        return self._queue_decided(decided) if decided else []

    def push_frame(self, frame: Frame) -> list[Output]:
        """Raises FRAME_INVALID for wrong size or a held sequence number, FRAME_TIME_WRONG and PAIRING_FULL as
        `Pairing.add_frame`; a receipt time vouches for the stamp.
        """
        depth = check_depth(frame.depth, shape=self._background.shape)
        if frame.sequence in self._seen:
            raise BlockRobotError("FRAME_INVALID", f"Frame {frame.sequence} came twice.")
        seen = _Seen(frame.sequence, frame.captured_at_ms)
        timeline = self.pairing.timeline_count
        vouched = frame.received_at_ms is not None
        decided = self.pairing.add_frame(frame.sequence, frame.captured_at_ms, vouched=vouched)
        before = self._end_timeline(decided) if self.pairing.timeline_count != timeline else []
        decided = [] if before else decided
        if self._newest_ms is not None and frame.captured_at_ms <= self._newest_ms:
            seen.disordered = True
        else:
            self._newest_ms = frame.captured_at_ms
            self._find_people(seen, drop_flying_pixels(depth) if self._time_of_flight else depth)
            if self._readings is not None:
                self._readings.weigh(self.matcher, frame.captured_at_ms)
            self.matcher.advance(frame.captured_at_ms)
        self._seen[frame.sequence] = seen
        return [*before, *self._queue_decided(decided)]

    def _find_people(self, seen: _Seen, depth: Depth) -> None:
        at_ms = seen.captured_at_ms
        place = self._find_place(at_ms)
        for hider in self._hiders:
            if not hider.is_blank and not self._may_be_home(place):
                continue
            found = hider.find_people(depth, place, at_ms)
            if found is not None:
                if place is not None and not hider.is_blank:
                    self._home.fit(place)
                seen.blank = hider.is_blank
                self._blank_frames_count += hider.is_blank
                if self._motion is not None and not hider.is_blank:
                    self._motion.confirm(at_ms)
                if self._second_look is not None and place is not None and not hider.is_blank:
                    found = self._second_look.look_again(found, depth, place, at_ms)
                elif self.lacks_floor:
                    found = found.withhold_all(WithholdReason.NO_GROUND)
                self._follow(seen, found)
                return
        seen.moved = True

    @property
    def lacks_floor(self) -> bool:
        """Nobody is kept by a robot that drives if the empty scene shows no floor: without it there is no second look."""
        return self._driving is not None and self._driving.keeps and self._mount is None

    def _may_be_home(self, place: RobotPlace | None) -> bool:
        """A robot that drives towards a wall sees nothing that its empty scene does not explain."""
        if self._motion is None:
            return True
        return place is not None and self._home.may_hold(place)

    def _find_place(self, at_ms: int) -> RobotPlace | None:
        """Nobody is followed across a jump of the odometry."""
        if self._motion is None:
            return None
        self._motion.keep_around(at_ms)
        place = self._motion.place_at(at_ms)
        if place is not None:
            if self._placed_by_ms is not None and not self._motion.is_continuous(self._placed_by_ms, at_ms):
                self._lose_everybody()
                self._home.go_on_after_break(place, self._motion)
            self._placed_by_ms = min(at_ms, self._motion.newest_ms or at_ms)
        return place

    def _follow(self, seen: _Seen, found: FoundPeople) -> None:
        at_ms = seen.captured_at_ms
        seen.stray = found.stray
        tracks = self._tracker.step(found.silhouettes, at_ms)
        for silhouette, track in zip(found.silhouettes, tracks, strict=True):
            if track is None:
                seen.merged = True
                continue
            self.matcher.add_track(track)
            if silhouette.label in found.may_show:
                seen.may_show[track.number] = found.may_show[silhouette.label]
            if silhouette.withhold_reason:
                seen.withhold_reasons[track.number] = silhouette.withhold_reason
            elif self._tracker.may_hide_somebody(track, at_ms):
                seen.withhold_reasons[track.number] = str(WithholdReason.OCCLUDED)
            else:
                seen.cutouts[track.number] = found.cut(silhouette)
        merged = [one for one, track in zip(found.silhouettes, tracks, strict=True) if track is None]
        evidence_found = [one.company for one in merged if one.company is not None]
        seen.company = min(evidence_found, key=lambda company: company.excess, default=None)
        unfollowed = [*(one.range_m for one in merged), *self._tracker.hidden_ranges]
        if unfollowed:
            self.matcher.note_unfollowed(at_ms, unfollowed)

    def _lose_everybody(self) -> None:
        self._tracker = self._tracker.successor()
        for hider in self._hiders:
            hider.restart()

    def advance(self, now_ms: int) -> list[Output]:
        """For a stopped camera."""
        self.matcher.advance(now_ms - self.pairing.lateness_ms)
        return self._queue_decided(self.pairing.advance(now_ms))

    def flush(self) -> list[Output]:
        self.matcher.finish()
        return [*self._queue_decided(self.pairing.flush()), *self._decide_pending(final=True)]

    def _end_timeline(self, decided: list[Decision]) -> list[Output]:
        """Settle everything before a camera clock reset; no track continues across."""
        outputs = [*self._queue_decided(decided), *self._decide_pending(final=True)]
        self.matcher = Matcher(drives=self._driving is not None)
        self._newest_ms, self._placed_by_ms, self._forgot_ms = None, None, 0
        self._bearings.restart()
        self._lose_everybody()
        self._home.lose()
        if self._motion is not None:
            self._motion.restart()
        if self._readings is not None:
            self._readings.restart()
        return outputs

    def _queue_decided(self, decided: list[Decision]) -> list[Output]:
        for decision in decided:
            seen = self._seen.pop(decision.sequence)
            for alias in decision.owners:
                self._pending.setdefault(alias, deque()).append(seen)
        return [*decided, *self._decide_pending()]

    def _decide_pending(self, *, final: bool = False) -> list[Output]:
        outputs: list[Output] = []
        now_ms = self.pairing.now_ms or 0
        for alias, queue in list(self._pending.items()):
            while queue:
                due = final or now_ms >= queue[0].captured_at_ms + self._buffer_ms
                decided = self._decide(alias, queue[0], due=due)
                if decided is None:
                    break
                queue.popleft()
                outputs.append(decided)
            if not queue:
                del self._pending[alias]
        if now_ms - self._forgot_ms > FORGET_EVERY_MS:
            self._forgot_ms = now_ms
            self.matcher.forget_before(now_ms - self._buffer_ms)
        return outputs

    def _decide(self, alias: str, seen: _Seen, *, due: bool) -> KeptFrame | WithheldFrame | None:
        """Return None while readings may still change it."""
        number = self.matcher.bound_track(alias, seen.tracks)
        reason: WithholdReason | None = None
        if number is not None and number in seen.cutouts:
            later = seen.may_show.get(number)
            if later is not None and not due:
                return None
            why_not = "" if later is None else later.why_not()
            if not why_not:
                return self._keep(alias, seen, number)
            reason = WithholdReason(why_not) if why_not in list(WithholdReason) else WithholdReason.UNVERIFIED
        elif seen.disordered:
            reason = WithholdReason.DISORDERED
        elif seen.moved:
            reason = WithholdReason.MOVED
        elif number is not None:
            reason = WithholdReason(seen.withhold_reasons[number])
        elif not seen.tracks:
            reason = WithholdReason.MERGED if seen.merged else WithholdReason.NO_SILHOUETTE
        elif due:
            driving = self._motion is not None and not self._motion.stands(seen.captured_at_ms)
            reason = WithholdReason.MOVED if driving else self._why_unbound(alias, seen)
        if reason is None:
            return None
        evidence: MatchEvidence | MergedEvidence | None = None
        if reason is WithholdReason.AMBIGUOUS:
            evidence = self.matcher.explain(alias, seen.tracks)
        elif reason is WithholdReason.MERGED and number is None:
            evidence = seen.company  # of others, if it is known who is the owner
        return WithheldFrame(seen.sequence, seen.captured_at_ms, alias, reason, evidence)

    def _keep(self, alias: str, seen: _Seen, number: int) -> KeptFrame:
        self._blank_kept_count += seen.blank
        alone = not seen.blank and len(seen.tracks) == 1 and not seen.merged and not seen.stray
        evidence_found = self.matcher.explain(alias, (number,))
        off = evidence_found if evidence_found is not None and evidence_found.is_off else None
        return KeptFrame(seen.sequence, seen.captured_at_ms, alias, seen.cutouts[number], alone, off, blank=seen.blank)

    def _why_unbound(self, alias: str, seen: _Seen) -> WithholdReason:
        if seen.merged:
            return WithholdReason.MERGED
        if self.matcher.is_elsewhere(alias, seen.captured_at_ms):
            return WithholdReason.NO_SILHOUETTE
        return WithholdReason.AMBIGUOUS if self.matcher.has_distance(alias) else WithholdReason.NO_DISTANCE
