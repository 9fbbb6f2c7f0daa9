"""Pipeline from sensor to chain: identify, pair, check consent, hide, seal, spool, deliver.

Image work and disk writes run in threads; a full spool applies back-pressure.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass

import msgspec

from clients.robot.consent.consent_filter import ConsentFilter
from clients.robot.consent.consent_view import Consents
from clients.robot.delivery.delivery import Delivered, Delivery
from clients.robot.hiding.background import EmptyFrame
from clients.robot.hiding.hider import Hider, Kept, Output
from clients.robot.pairing.rosters import RosterBook
from clients.robot.pairing.tag_pairing import REFUSED_AND_COUNTED, Decision
from clients.robot.pairing.unknown_tags import UnknownTags
from clients.robot.recording.batching import Batcher, ReadyClip
from clients.robot.recording.sealing import ClipContent, seal_clip
from clients.robot.recording.sensor_tracks import SensorTracks
from clients.robot.recording.spool import Spool, SpooledClip
from clients.robot.recording.unclosed_visits import OpenVisits
from clients.robot.recording.visit_book import VisitBook
from clients.robot.run.event_log import (
    BLOCKCHAIN_TRANSACTION,
    CLOCK_ESTIMATED,
    DATABASE_PERSISTANCE,
    IMAGE_PAIRED,
    IMAGE_RETRIEVE,
    MESSAGE_REFUSED,
    RFID_RETRIEVE,
    AliasBook,
    EventLog,
)
from clients.robot.run.run_statistics import RunStatistics
from clients.robot.run.run_summary import PipelineIntake
from clients.robot.sensing.input_throttle import InputThrottle
from clients.robot.sensing.sensor_events import Event, Frame, SensorSample, Sighting
from consensus.errors import BlockRobotError
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.renditions import ENCODING_PNG16, RENDITION_VERSION, Rendition

WAITING_CLIPS_MAX_COUNT = 512
QUIET_S = 1.0
CLOSE_EVERY_S = 15.0
_BACKPRESSURE_POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Camera:
    """The camera's record name and empty-scene frames."""

    sensor: str
    width: int
    height: int
    empty_frames: tuple[EmptyFrame, ...]


class Pipeline:
    """One run of the robot; `now_ms` is wall clock."""

    def __init__(
        self,
        *,
        camera: Camera,
        hider: Hider,
        roster: RosterBook,
        consents: Consents,
        visits: VisitBook,
        open_visits: OpenVisits,
        spool: Spool,
        delivery: Delivery,
        statistics: RunStatistics,
        log: EventLog,
        purpose: str,
        clip_ms: int,
        now_ms: Callable[[], int],
    ) -> None:
        self._camera = camera
        self._hider = hider
        self._roster = roster
        self._visits = visits
        self._open_visits = open_visits
        self._spool = spool
        self._delivery = delivery
        self._consents = consents
        self._statistics = statistics
        self._log = log
        self._batcher = Batcher(clip_ms)
        self._now_ms = now_ms
        self._aliases = AliasBook()
        self._keeper = ConsentFilter(
            consents,
            self._batcher,
            visits,
            statistics=statistics,
            log=log,
            purpose=purpose,
            sensor=camera.sensor,
            now_ms=now_ms,
        )
        self._senses = SensorTracks(
            consents,
            visits,
            open_visits,
            statistics=statistics,
            log=log,
            purpose=purpose,
            clip_ms=clip_ms,
            people=self._keeper.people,
            now_ms=now_ms,
        )
        consents.on_change = self._drop_refused
        self.admission = InputThrottle()
        self._unknown_tags = UnknownTags()
        self._busy = asyncio.Lock()
        self._taken_count = 0
        self._came_at_ms = 0  # when what is being worked on came, however busy the robot was then
        self._live = False
        self._storing: asyncio.Task[None] | None = None
        consents.camera_offset_ms = lambda: self.admission.clocks.camera_offset_ms

    def _drop_refused(self) -> None:
        self._keeper.drop_refused()
        self._senses.drop_refused()

    async def run(self, events: AsyncIterator[Event | SensorSample], *, live: bool = False) -> None:
        """Process a stream until records are final and visits closed, leftovers included.

        `live`: events come when received. Raises permanent failures, even while idle.
        """
        await asyncio.to_thread(self._open_visits.take_up, self._spool)
        for name in self._spool.names():
            self._delivery.start(name)
        self._live = live
        beside = asyncio.create_task(self._pass_time()) if live else None
        closing = asyncio.create_task(self._close_over())
        try:
            async for arrived in events if beside is None else _while_running(beside, events):
                self._consents.raise_failure()
                async with self._busy:
                    self._taken_count += 1
                    self._came_at_ms = self._find_arrival(arrived)
                    await self._take(arrived)
        finally:
            closing.cancel()
            if beside is not None:
                beside.cancel()
            # What is being written is whole in the spool before a run ends, whatever ends it.
            await asyncio.gather(closing, *filter(None, [self._storing]), return_exceptions=True)
        self._came_at_ms = self._now_ms()
        self.admission.clocks.flush()
        self._tell_intake()
        await self._seal(self._sort(await asyncio.to_thread(self._hider.flush)))
        await self._seal(self._batcher.flush())
        await self._deliver(self._senses.settle(final=True))
        await self._stored()
        await self._delivery.drain()
        await self._delivery.close_visits(self._open_visits)

    def summarise_intake(self) -> PipelineIntake:
        return self.admission.summarise(self._hider.pairing, self._unknown_tags)

    def _find_arrival(self, arrived: Event | SensorSample) -> int:
        now = self._now_ms()
        return min(now, arrived.received_at_ms or now) if self._live else now

    async def _take(self, arrived: Event | SensorSample) -> None:
        if not isinstance(arrived, Frame | Sighting):
            await self._senses.take(arrived, camera_offset_ms=self.admission.clocks.camera_offset_ms)
            return
        if isinstance(arrived, Frame):
            self._statistics.frame_arrived(arrived.sequence, self._now_ms())
            self._log.write(self._now_ms(), IMAGE_RETRIEVE, f"frame-{arrived.sequence}")
        for event in self.admission.clocks.admit(arrived):
            await self._work_on(event)
        if self.admission.is_time_to_tell():
            self._tell_intake()

    async def _pass_time(self) -> None:
        """Decide what is due by clock when the camera stops."""
        while True:
            idle, before, at_ms = not self._busy.locked(), self._taken_count, self._now_ms()
            await asyncio.sleep(QUIET_S)
            self._consents.raise_failure()
            if not idle or self._busy.locked() or self._taken_count != before:
                continue  # what is still to be worked on may have been received before
            async with self._busy:
                self._came_at_ms = self._now_ms()
                outputs = self._hider.advance(at_ms - self.admission.clocks.camera_offset_ms)
                await self._seal([*self._sort(outputs), *self._batcher.close_idle(self._now_ms())])
                await self._deliver(self._senses.settle())
                await self._stored()

    async def _close_over(self) -> None:
        while True:
            await asyncio.sleep(CLOSE_EVERY_S)
            await self._delivery.close_over(self._open_visits, lambda o: self._visits.goes_on(o, self._now_ms()))

    async def _work_on(self, event: Event) -> None:
        ready: list[ReadyClip] = []
        if isinstance(event, Frame):
            try:
                outputs = await asyncio.to_thread(self._hider.push_frame, event)
            except BlockRobotError as error:
                if error.code not in REFUSED_AND_COUNTED:
                    raise
                return
            self._senses.alone.see(event.sequence, event.captured_at_ms)
            ready = self._batcher.close_idle(self._now_ms())
        else:
            outputs = self._identify(event)
            if not outputs:  # most of a storm of readings ends here
                return
        await self._seal([*self._sort(outputs), *ready])
        await self._deliver(self._senses.settle())
        await self._hold_back()

    def _tell_intake(self) -> None:
        now = self._now_ms()
        for name, estimate in self.admission.clocks.estimates().items():
            self._log.write(now, CLOCK_ESTIMATED, f"clock-{name}", **msgspec.to_builtins(estimate.summarise()))
        for reason, count in self.admission.newly_turned_away(self._hider.pairing):
            self._log.write(now, MESSAGE_REFUSED, f"{reason}-turned-away", reason=reason, count=count)

    async def _hold_back(self) -> None:
        while len(self._spool.names()) > WAITING_CLIPS_MAX_COUNT:
            if self._delivery.failure is not None:
                raise self._delivery.failure
            await asyncio.sleep(_BACKPRESSURE_POLL_S)

    def _identify(self, sighting: Sighting) -> list[Output]:
        """Find the tag's bearer; without consent a tag counts as unknown."""
        row = self._roster.find(sighting.uid, self._came_at_ms)
        if row is None:
            self._unknown_tags.note(sighting.uid)
        consents = row is not None and self._keeper.is_tag_allowed(row, sighting.last_seen_ms)
        weighed = self.admission.weighs(sighting, known=consents)
        if not consents:
            self._senses.alone.note_stranger(sighting.first_seen_ms, sighting.last_seen_ms)
        if not consents and (not weighed or self._aliases.is_full):
            return self._hider.cover("", sighting, known=False)
        alias = self._aliases.alias(sighting.uid.encode())
        if row is not None and consents:
            self._keeper.people[alias] = row
        if not weighed:
            return self._hider.cover(alias, sighting, known=consents)
        self._log.write(self._now_ms(), RFID_RETRIEVE, alias, alias=alias)
        return self._hider.push_sighting(alias, sighting, known=consents)

    def _sort(self, outputs: list[Output]) -> list[ReadyClip]:
        ready: list[ReadyClip] = []
        now = self._now_ms()
        for output in outputs:
            case = f"frame-{output.sequence}"
            self._senses.alone.note(output)
            if isinstance(output, Decision):
                self._statistics.covered += len(output.owners)
                if output.reason:
                    self._log.write(now, output.reason, case)
                for alias in output.owners:
                    self._log.write(now, IMAGE_PAIRED, case, alias=alias)
            else:
                if isinstance(output, Kept):
                    self._statistics.frame_decided(output.alias, output.sequence, self._came_at_ms)
                ready.extend(self._keeper.take(output))
        return ready

    async def _seal(self, clips: list[ReadyClip]) -> None:
        for clip in clips:
            await self._stored()
            admitted = self._keeper.admit(clip)
            if admitted is not None:
                self._store(self._seal_one(admitted))

    async def _deliver(self, sealed: list[SpooledClip]) -> None:
        for clip in sealed:
            await self._stored()
            self._store(clip)

    def _store(self, clip: SpooledClip) -> None:
        """Spool a clip, then count it, and only then deliver."""

        async def store() -> None:
            try:
                name = await asyncio.to_thread(self._spool.put, clip)
            except BlockRobotError:
                self._open_visits.missed(clip.owner)
                with suppress(BlockRobotError):  # a full disk may not take the count either
                    await asyncio.to_thread(self._open_visits.save)
                raise
            self._open_visits.spooled(clip.owner, name)
            await asyncio.to_thread(self._open_visits.save)
            self._delivery.start(name)

        self._storing = asyncio.create_task(store())

    async def _stored(self) -> None:
        """Raises SPOOL_FULL."""
        if self._storing is not None:
            await asyncio.shield(self._storing)
            self._storing = None

    def _seal_one(self, clip: ReadyClip) -> SpooledClip:
        now = self._now_ms()
        chain = self._visits.chain_for(clip.alias, self._keeper.people[clip.alias], now)
        empty = random.SystemRandom().choice(self._camera.empty_frames)
        renditions = tuple(self._rendition(frame, empty) for frame in clip.frames) or (self._notice(empty, now),)
        sensor = self._camera.sensor if clip.frames else NOTICE_SENSOR
        content = ClipContent(
            renditions=renditions,
            withheld=clip.withheld,
            sensor=sensor,
            decided_at_ms=now,
            person=self._keeper.person_of(clip.alias),
            taken_by=self._keeper.sensor,
            offset_ms=self._keeper.offset_ms if clip.frames else 0,
        )
        spooled = seal_clip(content, chain, now_ms=now)
        self._open_visits.count(chain.owner, chain.record_count)
        frames = [(frame.sequence, frame.captured_at_ms) for frame in clip.frames]
        self._statistics.clip_sealed(spooled.upload.record_id, frames, clip.alias)
        return spooled

    def _rendition(self, frame: Kept, empty: EmptyFrame) -> Rendition:
        return Rendition(
            version=RENDITION_VERSION,
            captured_at_ms=frame.captured_at_ms,
            sequence=frame.sequence,
            width=self._camera.width,
            height=self._camera.height,
            x=frame.cut.x,
            y=frame.cut.y,
            box_width=frame.cut.width,
            box_height=frame.cut.height,
            background_id=empty.background_id,
            encoding=ENCODING_PNG16,
            pixels=frame.cut.pixels_png,
        )

    def _notice(self, empty: EmptyFrame, now_ms: int) -> Rendition:
        return Rendition(
            version=RENDITION_VERSION,
            captured_at_ms=now_ms,
            sequence=0,
            width=self._camera.width,
            height=self._camera.height,
            x=0,
            y=0,
            box_width=0,
            box_height=0,
            background_id=empty.background_id,
            encoding=ENCODING_PNG16,
            pixels=b"",
        )


async def _while_running(
    beside: asyncio.Task[None], events: AsyncIterator[Event | SensorSample]
) -> AsyncIterator[Event | SensorSample]:
    """Yield events; raise once the task beside them fails."""
    coming: asyncio.Task[Event | SensorSample | None] | None = None

    async def next_one() -> Event | SensorSample | None:
        return await anext(events, None)

    try:
        while True:
            coming = asyncio.create_task(next_one())
            await asyncio.wait({coming, beside}, return_when=asyncio.FIRST_COMPLETED)
            if beside.done():
                beside.result()
            arrived = await coming
            if arrived is None:
                return
            yield arrived
    finally:
        if coming is not None and not coming.done():
            coming.cancel()
            await asyncio.gather(coming, return_exceptions=True)


def note_delivered(done: Delivered, statistics: RunStatistics, log: EventLog) -> None:
    """Count a final record and log its frames' times, never its id."""
    sealed = statistics.delivered(done)
    for (sequence, _), decided_at_ms in zip(sealed.frames, sealed.decided_at_ms, strict=True):
        case = f"frame-{sequence}"
        log.write(done.submitted_at_ms, DATABASE_PERSISTANCE, case, alias=sealed.alias)
        told = {} if decided_at_ms is None else {"decided_at_ms": decided_at_ms}
        log.write(done.final_at_ms, BLOCKCHAIN_TRANSACTION, case, alias=sealed.alias, **told)
