"""One sensor's way from hiding to a sealed clip: consent, batching, sealing.

Consent is checked at tag reading, after hiding, at sealing, and (in delivery) before recording; waiting samples are dropped
once a refusal is seen.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec

from clients.robot.consent.consent_view import Consents
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import KeptFrame, SampleForm, WithheldFrame
from clients.robot.hiding.withhold_reason import MergedEvidence, WithholdReason
from clients.robot.matching.match_evidence import MatchEvidence
from clients.robot.recording.batching import Batcher, ReadyClip
from clients.robot.recording.event_log import EventLog
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sealing import ClipContent, seal_clip
from clients.robot.recording.spool import SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import VisitKeyring
from clients.robot.sensing.sensor_clocks import RunClocks
from consensus.members.roster import RosterRow
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.renditions import BOXLESS, NO_BACKGROUND, RENDITION_VERSION, Rendition

CONSENT_COMING = "consent-coming"
"""Counted for a reading whose bearer's consent is on the chain, but has not begun."""

NO_PICTURE = SampleForm()
_NOTHING = EncodedCutout(0, 0, 0, 0, b"")


@dataclass(frozen=True, slots=True)
class RunContext:
    """What the tracks of a run share; `now_ms` is wall clock."""

    consents: Consents
    visits: VisitKeyring
    open_visits: UnclosedVisitStore
    log: EventLog
    clip_ms: int
    now_ms: Callable[[], int]
    clocks: RunClocks = field(default_factory=RunClocks)


class SensorRecorder:
    """One sensor of a run, for the visits' purpose; `people`: whose rows aliases are.

    `form` and `background_ids`: of notices, and of samples without a form of their own.
    """

    def __init__(
        self,
        run: RunContext,
        sensor: str,
        people: Mapping[str, RosterRow],
        statistics: RunStatistics,
        *,
        form: SampleForm = NO_PICTURE,
        background_ids: tuple[bytes, ...] = (NO_BACKGROUND,),
    ) -> None:
        self._run = run
        self._consents = run.consents
        self._visits = run.visits
        self._now_ms = run.now_ms
        self._people = people
        self._statistics = statistics
        self._form = form
        self._background_ids = background_ids
        self.sensor = sensor
        self.batcher = Batcher(run.clip_ms)
        self._kept: dict[str, int | None] = {}  # since when the owner consented to what was kept first of a visit

    def is_tag_allowed(self, row: RosterRow, read_at_ms: int) -> bool:
        """Return whether a tag read at this camera time is known."""
        refusal = self._check_may_keep(row, read_at_ms + self._offset_ms)
        if refusal is not None:
            place = (row.handle, self._visits.purpose, self.sensor)
            coming = refusal is WithholdReason.NO_CONSENT and self._consents.is_coming(*place)
            why = CONSENT_COMING if coming else str(refusal)
            refused = self._consents.figures.sightings_refused
            refused[why] = refused.get(why, 0) + 1
        return refusal is None

    def process(self, output: KeptFrame | WithheldFrame) -> list[ReadyClip]:
        """Return the clips that an output closes."""
        row = self._people[output.alias]
        refusal = self._check_may_keep(row, output.captured_at_ms + self._offset_ms)
        if isinstance(output, KeptFrame) and refusal is None:
            if output.evidence is not None:
                self._statistics.add_off(output.alias, output.evidence)
            self._kept.setdefault(output.alias, self._find_beginning(row))
            return self.batcher.add_kept(output, self._now_ms())
        # Only people who consent get the reason: for others, it would be a record of them.
        may_tell = refusal is None or refusal is WithholdReason.STALE
        reported = str(output.reason if isinstance(output, WithheldFrame) and may_tell else refusal)
        evidence = output.evidence if isinstance(output, WithheldFrame) and may_tell else None
        self._note_withheld(output.sequence, output.alias, reported, evidence)
        if may_tell:
            self.batcher.add_withheld(output.alias, reported)
        return []

    def close(self, *, final: bool = False) -> list[ReadyClip]:
        """Return clips without a new sample for a clip's length; `final`: all."""
        return self.batcher.flush() if final else self.batcher.close_idle(self._now_ms())

    def seal(self, ready: ReadyClip) -> SpooledClip | None:
        """None if nothing may be sealed."""
        clip = self.admit(ready)
        if clip is None:
            return None
        now, row = self._now_ms(), self._people[clip.alias]
        chain = self._visits.chain_for(clip.alias, row, now)
        background_id = random.SystemRandom().choice(self._background_ids)
        frames = clip.frames or (KeptFrame(0, now, clip.alias, _NOTHING),)  # a notice has nothing but its time
        content = ClipContent(
            renditions=tuple(_rendition(frame, frame.form or self._form, background_id) for frame in frames),
            withheld=clip.withheld,
            sensor=self.sensor if clip.frames else NOTICE_SENSOR,
            decided_at_ms=now,
            person=self._consents.person_tag(row.handle),
            taken_by=self.sensor,
            offset_ms=self._offset_ms if clip.frames else 0,
        )
        sealed = seal_clip(content, chain, now_ms=now)
        self._run.open_visits.count(chain.owner, chain.record_count)
        times = [(frame.sequence, frame.captured_at_ms) for frame in clip.frames]
        self._statistics.clip_sealed(sealed.upload.record_id, times, clip.alias)
        return sealed

    def admit(self, clip: ReadyClip) -> ReadyClip | None:
        """Return the part that may be sealed."""
        row = self._people[clip.alias]
        kept, stale_count = [], 0
        for frame in clip.frames:
            refusal = self._check_may_keep(row, frame.captured_at_ms + self._offset_ms)
            if refusal is None:
                kept.append(frame)
            else:
                self._note_withheld(frame.sequence, clip.alias, str(refusal))
                stale_count += refusal is WithholdReason.STALE
        withheld = Counter(dict(clip.withheld)) + Counter({str(WithholdReason.STALE): stale_count})
        now_refusal = self._check_may_keep(row, self._now_ms())
        if kept or (withheld and now_refusal is None):
            return ReadyClip(alias=clip.alias, frames=tuple(kept), withheld=tuple(sorted(withheld.items())))
        if now_refusal is WithholdReason.STALE:
            for reason, count in withheld.items():
                self.batcher.add_withheld(clip.alias, reason, count)
        return None

    def drop_refused(self) -> None:
        """After each reading, drop samples and end visits without consent."""
        for alias, row in self._people.items():
            refusal = self._check_may_keep(row, self._now_ms())
            if refusal is WithholdReason.NO_CONSENT:
                for frame in self.batcher.drop(alias):
                    self._note_withheld(frame.sequence, alias, str(WithholdReason.NO_CONSENT))
            is_broken = alias in self._kept and self._kept[alias] != self._find_beginning(row)
            if refusal is not WithholdReason.STALE and is_broken:
                del self._kept[alias]
                self._visits.forget(alias)

    @property
    def _offset_ms(self) -> int:
        """Robot clock minus camera clock, which samples and readings carry."""
        return self._run.clocks.camera_offset_ms

    def _find_beginning(self, row: RosterRow) -> int | None:
        return self._consents.find_beginning(row.handle, self._visits.purpose, self.sensor)

    def _check_may_keep(self, row: RosterRow, taken_at_ms: int) -> WithholdReason | None:
        return self._consents.check_may_keep(row.handle, self._visits.purpose, self.sensor, taken_at_ms)

    def _note_withheld(
        self, sequence: int, alias: str, reason: str, evidence: MatchEvidence | MergedEvidence | None = None
    ) -> None:
        self._statistics.add_withheld(reason)
        self._statistics.forget_decided(alias, sequence)
        if isinstance(evidence, MatchEvidence):
            self._statistics.add_ambiguous(alias, evidence)
        elif evidence is not None:
            self._statistics.add_merged(alias, evidence)
        numbers = {} if evidence is None else msgspec.to_builtins(evidence.summarise())
        self._run.log.write_withheld(self._now_ms(), self.sensor, sequence, alias=alias, reason=reason, **numbers)


def _rendition(frame: KeptFrame, form: SampleForm, background_id: bytes) -> Rendition:
    has_box = form.encoding not in BOXLESS
    return Rendition(
        version=RENDITION_VERSION,
        captured_at_ms=frame.captured_at_ms,
        sequence=frame.sequence,
        width=form.width,
        height=form.height,
        x=frame.cutout.x,
        y=frame.cutout.y,
        box_width=frame.cutout.width if has_box else 0,
        box_height=frame.cutout.height if has_box else 0,
        background_id=NO_BACKGROUND if frame.blank else background_id,
        encoding=form.encoding,
        pixels=frame.cutout.pixels_png,
    )
