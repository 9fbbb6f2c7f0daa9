"""Redacts a camera's stream frame by frame: a `KeptFrame` or `WithheldFrame` per covered frame and owner, in time order,
nobody else in any picture.

Silhouettes are cut out on arrival and whole frames never held; ambiguity means withheld.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from clients.robot.hiding.background import Background, fits
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.cutouts import EncodedCutout, extract_encoded_cutout
from clients.robot.hiding.match_evidence import MatchEvidence
from clients.robot.hiding.matcher import Matcher
from clients.robot.hiding.segmentation import EMPTY_MAX_PX, Segmented, segment
from clients.robot.hiding.tracking import Tracker
from clients.robot.hiding.withhold_reason import MergedEvidence, WithholdReason
from clients.robot.pairing.tag_pairing import LATENESS_DEFAULT_MS, WINDOW_DEFAULT_MS, Decision, Pairing
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sensing.sensor_events import Frame, Sighting, check_depth
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
    alone: bool = False  # whether nobody else is in the picture, as far as the camera measures depth
    evidence: MatchEvidence | None = None  # only where distances disagree with the camera's all the same
    form: SampleForm | None = None  # None: a depth frame of the camera


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

    @property
    def tracks(self) -> tuple[int, ...]:
        return (*self.cutouts, *self.withhold_reasons)


class FrameRedactor:
    """Pairs, segments, tracks, matches and cuts. Not thread-safe. Calls return settled outputs: each frame's `Decision`
    once, then `KeptFrame` or `WithheldFrame` per owner.
    """

    def __init__(
        self,
        background: Background,
        *,
        focal_px: float = FOCAL_DEFAULT_PX,
        window_ms: int = WINDOW_DEFAULT_MS,
        lateness_ms: int = LATENESS_DEFAULT_MS,
        buffer_ms: int = BUFFER_DEFAULT_MS,
    ) -> None:
        self.pairing = Pairing(window_ms, lateness_ms)
        self.matcher = Matcher()
        self._background = background
        self._focal_px = focal_px
        self._buffer_ms = max(buffer_ms, window_ms + lateness_ms + 1)
        self._tracker = Tracker()
        self._companions = CompanionWatch()
        self._seen: dict[int, _Seen] = {}
        self._pending: dict[str, deque[_Seen]] = {}
        self._newest_ms: int | None = None
        self._forgot_ms = 0

    def use_focal_px(self, focal_px: float) -> None:
        self._focal_px = focal_px

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
        self.matcher.add_sighting(alias, sighting, known=known)
        return outputs

    def cover(self, alias: str, sighting: Sighting, *, known: bool = True) -> list[Output]:
        """Add a sighting for pairing only."""
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
        elif not fits(self._background, depth):
            self._newest_ms = frame.captured_at_ms
            seen.moved = True
            self.matcher.advance(frame.captured_at_ms)
        else:
            self._newest_ms = frame.captured_at_ms
            segmented = segment(depth, self._background, self._focal_px)
            seen.stray = _stray_px(segmented) >= EMPTY_MAX_PX
            silhouettes = self._companions.step(segmented.silhouettes, frame.captured_at_ms)
            tracks = self._tracker.step(silhouettes, frame.captured_at_ms)
            for silhouette, track in zip(silhouettes, tracks, strict=True):
                if track is None:
                    seen.merged = True
                    continue
                self.matcher.add_track(track)
                if silhouette.withhold_reason:
                    seen.withhold_reasons[track.number] = silhouette.withhold_reason
                else:
                    seen.cutouts[track.number] = extract_encoded_cutout(depth, self._background, segmented, silhouette)
            merged = [one for one, track in zip(silhouettes, tracks, strict=True) if track is None]
            evidence_found = [one.company for one in merged if one.company is not None]
            seen.company = min(evidence_found, key=lambda company: company.excess, default=None)
            unfollowed = [*(one.range_m for one in merged), *self._tracker.hidden_ranges]
            if unfollowed:
                self.matcher.note_unfollowed(frame.captured_at_ms, unfollowed)
            self.matcher.advance(frame.captured_at_ms)
        self._seen[frame.sequence] = seen
        return [*before, *self._queue_decided(decided)]

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
        self.matcher, self._tracker, self._companions = Matcher(), Tracker(), CompanionWatch()
        self._newest_ms, self._forgot_ms = None, 0
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
                verdict = self._verdict(alias, queue[0], due=due)
                if verdict is None:
                    break
                queue.popleft()
                outputs.append(verdict)
            if not queue:
                del self._pending[alias]
        if now_ms - self._forgot_ms > FORGET_EVERY_MS:
            self._forgot_ms = now_ms
            self.matcher.forget_before(now_ms - self._buffer_ms)
        return outputs

    def _verdict(self, alias: str, seen: _Seen, *, due: bool) -> KeptFrame | WithheldFrame | None:
        """Return None while readings may still change it."""
        number = self.matcher.bound_track(alias, seen.tracks)
        if number is not None and number in seen.cutouts:
            alone = len(seen.tracks) == 1 and not seen.merged and not seen.stray
            evidence_found = self.matcher.explain(alias, (number,))
            off = evidence_found if evidence_found is not None and evidence_found.is_off else None
            return KeptFrame(seen.sequence, seen.captured_at_ms, alias, seen.cutouts[number], alone, off)
        reason: WithholdReason | None = None
        if seen.disordered:
            reason = WithholdReason.DISORDERED
        elif seen.moved:
            reason = WithholdReason.MOVED
        elif number is not None:
            reason = WithholdReason(seen.withhold_reasons[number])
        elif not seen.tracks:
            reason = WithholdReason.MERGED if seen.merged else WithholdReason.NO_SILHOUETTE
        elif due:
            reason = self._why_unbound(alias, seen)
        if reason is None:
            return None
        evidence: MatchEvidence | MergedEvidence | None = None
        if reason is WithholdReason.AMBIGUOUS:
            evidence = self.matcher.explain(alias, seen.tracks)
        elif reason is WithholdReason.MERGED:
            evidence = seen.company
        return WithheldFrame(seen.sequence, seen.captured_at_ms, alias, reason, evidence)

    def _why_unbound(self, alias: str, seen: _Seen) -> WithholdReason:
        if seen.merged:
            return WithholdReason.MERGED
        if self.matcher.is_elsewhere(alias, seen.captured_at_ms):
            return WithholdReason.NO_SILHOUETTE
        return WithholdReason.AMBIGUOUS if self.matcher.has_distance(alias) else WithholdReason.NO_DISTANCE


def _stray_px(segmented: Segmented) -> int:
    """Half-resolution foreground outside silhouettes."""
    if segmented.labels is None:
        return 0
    counts = np.bincount(segmented.labels.ravel() + 1, minlength=2)  # labels begin with -1
    found = [silhouette.label for silhouette in segmented.silhouettes]
    return int(counts.sum() - counts[[1, *(label + 1 for label in found)]].sum())
