"""Consent filter between hiding and sealing, by the current registry view.

Checked at tag reading, after hiding, at sealing, and (in delivery) before recording; waiting pictures are dropped once
a refusal is seen.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable

import msgspec

from clients.robot.consent.consent_view import Consents, Refusal
from clients.robot.hiding.hider import Kept, Withheld
from clients.robot.hiding.match_evidence import MatchEvidence
from clients.robot.hiding.merged_evidence import MergedEvidence
from clients.robot.recording.batching import Batcher, ReadyClip
from clients.robot.recording.spool import SpooledClip
from clients.robot.recording.unclosed_visits import OpenVisits
from clients.robot.recording.visit_book import VisitBook
from clients.robot.run.event_log import IMAGE_WITHHELD, SENSE_WITHHELD, EventLog
from clients.robot.run.run_statistics import RunStatistics
from consensus.members.roster import RosterRow

CONSENT_COMING = "consent-coming"
"""Counted for a reading whose bearer's consent is on the chain, but has not begun."""


class ConsentFilter:
    """One sensor's pictures of one run, recorded for one purpose."""

    def __init__(
        self,
        consents: Consents,
        batcher: Batcher,
        visits: VisitBook,
        *,
        statistics: RunStatistics,
        log: EventLog,
        purpose: str,
        sensor: str,
        now_ms: Callable[[], int],
    ) -> None:
        self._consents = consents
        self._batcher = batcher
        self._visits = visits
        self._statistics = statistics
        self._log = log
        self._purpose = purpose
        self._now_ms = now_ms
        self.sensor = sensor
        self.people: dict[str, RosterRow] = {}
        self._kept: dict[str, int | None] = {}  # since when the owner consented to what was kept first of a visit

    def is_tag_allowed(self, row: RosterRow, read_at_ms: int) -> bool:
        """Return whether a tag read at this camera time is known."""
        refusal = self._find_refusal(row, read_at_ms + self.offset_ms)
        if refusal is not None:
            coming = refusal is Refusal.NO_CONSENT and self._consents.is_coming(row.handle, self._purpose, self.sensor)
            why = CONSENT_COMING if coming else str(refusal)
            refused = self._consents.figures.sightings_refused
            refused[why] = refused.get(why, 0) + 1
        return refusal is None

    @property
    def offset_ms(self) -> int:
        """Robot clock minus camera clock; pictures and readings carry camera time."""
        return self._consents.camera_offset_ms()

    def person_of(self, alias: str) -> bytes:
        return self._consents.person_tag(self.people[alias].handle)

    def take(self, output: Kept | Withheld) -> list[ReadyClip]:
        refusal = self._find_refusal(self.people[output.alias], output.captured_at_ms + self.offset_ms)
        if isinstance(output, Kept) and refusal is None:
            if output.evidence is not None:
                self._statistics.add_off(output.alias, output.evidence)
            self._kept.setdefault(output.alias, self._find_beginning(self.people[output.alias]))
            return self._batcher.add_kept(output, self._now_ms())
        self._withhold(output, str(output.reason if isinstance(output, Withheld) else refusal), refusal)
        return []

    def withhold(self, output: Kept | Withheld, reason: str) -> None:
        """Withhold for another reason, reported to the owner."""
        refusal = self._find_refusal(self.people[output.alias], output.captured_at_ms + self.offset_ms)
        self._withhold(output, reason, refusal)

    def _withhold(self, output: Kept | Withheld, reason: str, refusal: Refusal | None) -> None:
        """Count; report the reason only to consenting owners: it would record others."""
        may_tell = refusal is None or refusal is Refusal.STALE
        told = reason if may_tell else str(refusal)
        evidence = output.evidence if may_tell and isinstance(output, Withheld) else None
        self._note_withheld(output.sequence, output.alias, told, evidence)
        if may_tell:
            self._batcher.add_withheld(output.alias, told)

    def admit(self, clip: ReadyClip) -> ReadyClip | None:
        """Return a clip's sealable part, or None."""
        row = self.people[clip.alias]
        kept, stale_count = [], 0
        for frame in clip.frames:
            refusal = self._find_refusal(row, frame.captured_at_ms + self.offset_ms)
            if refusal is None:
                kept.append(frame)
            else:
                self._note_withheld(frame.sequence, clip.alias, str(refusal))
                stale_count += refusal is Refusal.STALE
        withheld = Counter(dict(clip.withheld)) + Counter({str(Refusal.STALE): stale_count})
        now_refusal = self._find_refusal(row, self._now_ms())
        if kept or (withheld and now_refusal is None):
            return ReadyClip(alias=clip.alias, frames=tuple(kept), withheld=tuple(sorted(withheld.items())))
        if now_refusal is Refusal.STALE:
            for reason, count in withheld.items():
                self._batcher.add_withheld(clip.alias, reason, count)
        return None

    def drop_refused(self) -> None:
        """After each reading, drop pictures and end visits without consent."""
        for alias, row in self.people.items():
            refusal = self._find_refusal(row, self._now_ms())
            if refusal is Refusal.NO_CONSENT:
                for frame in self._batcher.drop(alias):
                    self._note_withheld(frame.sequence, alias, str(Refusal.NO_CONSENT))
            is_broken = alias in self._kept and self._kept[alias] != self._find_beginning(row)
            if refusal is not Refusal.STALE and is_broken:
                del self._kept[alias]
                self._visits.forget(alias)

    def _find_beginning(self, row: RosterRow) -> int | None:
        return self._consents.find_beginning(row.handle, self._purpose, self.sensor)

    def _find_refusal(self, row: RosterRow, taken_at_ms: int) -> Refusal | None:
        return self._consents.find_refusal(row.handle, self._purpose, self.sensor, taken_at_ms)

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
        self._log.write(self._now_ms(), IMAGE_WITHHELD, f"frame-{sequence}", alias=alias, reason=reason, **numbers)


async def note_dropped(
    clip: SpooledClip,
    consents: Consents,
    statistics: RunStatistics,
    open_visits: OpenVisits,
    log: EventLog,
    now_ms: int,
) -> None:
    """Count a clip destroyed for ended consent. Raises SPOOL_FULL."""
    consents.figures.clips_dropped += 1
    open_visits.lower(clip.owner)
    reason = str(Refusal.NO_CONSENT)
    for sensor, sense in statistics.senses.items():
        for sequence, _ in (dropped := sense.clip_dropped(clip.upload.record_id, reason)).frames:
            log.write(now_ms, SENSE_WITHHELD, f"{sensor}-{sequence}", alias=dropped.alias, reason=reason)
    sealed = statistics.clip_dropped(clip.upload.record_id, reason)
    for sequence, _ in sealed.frames:
        log.write(now_ms, IMAGE_WITHHELD, f"frame-{sequence}", alias=sealed.alias, reason=reason)
    await asyncio.to_thread(open_visits.save)
