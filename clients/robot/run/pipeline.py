"""Pipeline from sensor to chain: identify, pair, check consent, hide, seal, spool, deliver.

Image work and disk writes run in threads; a full spool applies back-pressure.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import suppress

import msgspec

from clients.robot.delivery.delivery import Delivery
from clients.robot.hiding.background import EmptyFrame
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.pairing.input_throttle import InputThrottle, PipelineIntake
from clients.robot.pairing.rosters import RosterBook, UnknownTags
from clients.robot.pairing.tag_pairing import REFUSED_AND_COUNTED, Decision
from clients.robot.recording.batching import ReadyClip
from clients.robot.recording.event_log import (
    BLOCKCHAIN_TRANSACTION,
    CLOCK_ESTIMATED,
    DATABASE_PERSISTANCE,
    DEPTH,
    IMAGE_PAIRED,
    IMAGE_RETRIEVE,
    MESSAGE_REFUSED,
    RFID_RETRIEVE,
    AliasBook,
    EventLog,
)
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import RunContext, SensorRecorder
from clients.robot.recording.spool import Delivered, Spool, SpooledClip
from clients.robot.recording.waiting_samples import WaitingSamples
from clients.robot.sensing.sensor_events import Event, Frame, Odometry, SensorSample, Sighting
from consensus.errors import BlockRobotError
from consensus.members.roster import RosterRow

WAITING_CLIPS_MAX_COUNT = 512
QUIET_S = 1.0
CLOSE_EVERY_S = 15.0
_BACKPRESSURE_POLL_S = 0.05


class Pipeline:
    """One run; its pictures are put onto `empty_frames`."""

    def __init__(
        self,
        *,
        run: RunContext,
        empty_frames: tuple[EmptyFrame, ...],
        redactor: FrameRedactor,
        roster: RosterBook,
        spool: Spool,
        delivery: Delivery,
        statistics: RunStatistics,
    ) -> None:
        self._consents = run.consents
        self._visits = run.visits
        self._open_visits = run.open_visits
        self._log = run.log
        self._now_ms = run.now_ms
        self._clocks = run.clocks
        self._redactor = redactor
        self._roster = roster
        self._spool = spool
        self._delivery = delivery
        self._statistics = statistics
        self._people: dict[str, RosterRow] = {}  # written by `_identify` only
        backgrounds = tuple(frame.background_id for frame in empty_frames)
        form = redactor.form
        self._depth = SensorRecorder(run, DEPTH, self._people, statistics, form=form, background_ids=backgrounds)
        self._samples = WaitingSamples(run, self._people, statistics)
        self._throttle = InputThrottle(run.clocks)
        self._aliases = AliasBook()
        self._unknown_tags = UnknownTags()
        self._came_at_ms = 0  # when what is being worked on came, however busy the robot was then
        self._live = False
        self._storing: asyncio.Task[None] | None = None
        self._consents.on_change = self._drop_refused

    def _drop_refused(self) -> None:
        for track in (self._depth, *self._samples.tracks.values()):
            track.drop_refused()

    async def run(self, events: AsyncIterator[Event | SensorSample], *, live: bool = False) -> None:
        """Process a stream until records are final and visits closed, leftovers included. `live`: events come when
        received. Raises permanent failures, even while idle.
        """
        await asyncio.to_thread(self._open_visits.recover_spooled, self._spool)
        for name in self._spool.names():
            self._delivery.start(name)
        self._live = live
        closing = asyncio.create_task(self._close_over())
        try:
            async for arrived in self._with_idle_work(events) if live else events:
                self._consents.raise_failure()
                self._came_at_ms = self._find_arrival(arrived)
                await self._process_arrival(arrived)
        finally:
            closing.cancel()
            # What is being written is whole in the spool before a run ends, whatever ends it.
            await asyncio.gather(closing, *filter(None, [self._storing]), return_exceptions=True)
        self._came_at_ms = self._now_ms()
        self._clocks.flush()
        self._log_intake()
        for clip in self._route(await asyncio.to_thread(self._redactor.flush)):
            await self._seal(self._depth, clip)
        await self._seal_settled(self._depth.close(final=True), final=True)
        await self._wait_until_stored()
        await self._delivery.drain()
        await self._delivery.close_visits(self._open_visits)

    async def _with_idle_work(self, events: AsyncIterator[Event | SensorSample]) -> AsyncIterator[Event | SensorSample]:
        """Whenever nothing but odometry comes for `QUIET_S`, decide what is due by clock."""
        coming = asyncio.ensure_future(anext(events, None))
        clock = asyncio.get_running_loop()
        quiet_from_s = clock.time()
        try:
            while True:
                at_ms = self._now_ms()  # what was received before would come at once
                done, _ = await asyncio.wait({coming}, timeout=QUIET_S)
                arrived = coming.result() if done else None
                if done and arrived is None:
                    return
                if arrived is not None:
                    yield arrived
                    at_ms = self._find_arrival(arrived)
                    coming = asyncio.ensure_future(anext(events, None))
                if arrived is not None and not isinstance(arrived, Odometry):
                    quiet_from_s = clock.time()
                elif not done or clock.time() - quiet_from_s >= QUIET_S:
                    quiet_from_s = clock.time()
                    self._consents.raise_failure()
                    await self._advance_when_idle(at_ms)
        finally:
            coming.cancel()
            await asyncio.gather(coming, return_exceptions=True)

    def summarise_intake(self) -> PipelineIntake:
        return self._throttle.summarise(self._redactor.pairing, self._unknown_tags)

    def _find_arrival(self, arrived: Event | SensorSample) -> int:
        now = self._now_ms()
        return min(now, arrived.received_at_ms or now) if self._live else now

    async def _process_arrival(self, arrived: Event | SensorSample) -> None:
        if not isinstance(arrived, Frame | Sighting | Odometry):
            await self._samples.process(arrived)
            return
        if isinstance(arrived, Frame):
            self._statistics.frame_arrived(arrived.sequence, self._now_ms())
            self._log.write(self._now_ms(), IMAGE_RETRIEVE, f"frame-{arrived.sequence}")
        for event in self._clocks.admit(arrived):
            await self._process_event(event)
        if self._throttle.is_time_to_tell():
            self._log_intake()

    async def _advance_when_idle(self, at_ms: int) -> None:
        self._came_at_ms = self._now_ms()
        outputs = self._redactor.advance(at_ms - self._clocks.camera_offset_ms)
        await self._seal_settled([*self._route(outputs), *self._depth.close()])
        await self._wait_until_stored()

    async def _close_over(self) -> None:
        while True:
            await asyncio.sleep(CLOSE_EVERY_S)
            await self._delivery.close_over(self._open_visits, lambda o: self._visits.goes_on(o, self._now_ms()))

    async def _process_event(self, event: Event) -> None:
        ready: list[ReadyClip] = []
        if isinstance(event, Odometry):
            self._redactor.push_odometry(event)
            return
        if isinstance(event, Frame):
            try:
                outputs = await asyncio.to_thread(self._hide, event)
            except BlockRobotError as error:
                if error.code not in REFUSED_AND_COUNTED:
                    raise
                return
            self._samples.alone.add_frame(event.sequence, event.captured_at_ms)
            ready = self._depth.close()
        else:
            outputs = self._identify(event)
            if not outputs:  # most of a storm of readings ends here
                return
        await self._seal_settled([*self._route(outputs), *ready])
        await self._wait_for_spool_room()

    def _hide(self, frame: Frame) -> list[Output]:
        began_s = time.thread_time()
        try:
            return self._redactor.push_frame(frame)
        finally:
            self._statistics.hiding.add(1000 * (time.thread_time() - began_s))

    def _log_intake(self) -> None:
        now = self._now_ms()
        for name, estimate in self._clocks.estimates().items():
            self._log.write(now, CLOCK_ESTIMATED, f"clock-{name}", **msgspec.to_builtins(estimate.summarise()))
        for reason, count in self._throttle.newly_turned_away(self._redactor.pairing):
            self._log.write(now, MESSAGE_REFUSED, f"{reason}-turned-away", reason=reason, count=count)

    async def _wait_for_spool_room(self) -> None:
        while len(self._spool.names()) > WAITING_CLIPS_MAX_COUNT:
            if self._delivery.failure is not None:
                raise self._delivery.failure
            await asyncio.sleep(_BACKPRESSURE_POLL_S)

    def _identify(self, sighting: Sighting) -> list[Output]:
        """Without consent a tag counts as unknown."""
        row = self._roster.find(sighting.uid, self._came_at_ms)
        if row is None:
            self._unknown_tags.note(sighting.uid)
        consents = row is not None and self._depth.is_tag_allowed(row, sighting.last_seen_ms)
        weighed = self._throttle.weighs(sighting, known=consents)
        if not consents:
            self._samples.alone.note_stranger(sighting.first_seen_ms, sighting.last_seen_ms)
        if not consents and (not weighed or self._aliases.is_full):
            return self._redactor.cover("", sighting, known=False)
        alias = self._aliases.alias(sighting.uid.encode())
        if row is not None and consents:
            self._people[alias] = row
        if not weighed:
            return self._redactor.cover(alias, sighting, known=consents)
        self._log.write(self._now_ms(), RFID_RETRIEVE, alias, alias=alias)
        return self._redactor.push_sighting(alias, sighting, known=consents)

    def _route(self, outputs: list[Output]) -> list[ReadyClip]:
        """Return clips that are full."""
        ready: list[ReadyClip] = []
        now = self._now_ms()
        for output in outputs:
            case = f"frame-{output.sequence}"
            self._samples.alone.note(output)
            if isinstance(output, Decision):
                self._statistics.covered += len(output.owners)
                if output.reason:
                    self._log.write(now, output.reason, case)
                for alias in output.owners:
                    self._log.write(now, IMAGE_PAIRED, case, alias=alias)
            else:
                if isinstance(output, KeptFrame):
                    self._statistics.frame_decided(output.alias, output.sequence, self._came_at_ms)
                ready.extend(self._depth.process(output))
        return ready

    async def _seal_settled(self, clips: list[ReadyClip], *, final: bool = False) -> None:
        """Clips of depth, then of sensors on which depth has decided."""
        for clip in clips:
            await self._seal(self._depth, clip)
        for track, clip in self._samples.drain(final=final):
            await self._seal(track, clip)

    async def _seal(self, track: SensorRecorder, clip: ReadyClip) -> None:
        await self._wait_until_stored()
        sealed = track.seal(clip)
        if sealed is not None:
            self._store(sealed)

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

    async def _wait_until_stored(self) -> None:
        """Raises SPOOL_FULL."""
        if self._storing is not None:
            await asyncio.shield(self._storing)
            self._storing = None


def note_delivered(done: Delivered, statistics: RunStatistics, log: EventLog) -> None:
    """Never its id."""
    sealed = statistics.delivered(done)
    for (sequence, _), decided_at_ms in zip(sealed.frames, sealed.decided_at_ms, strict=True):
        case = f"frame-{sequence}"
        log.write(done.submitted_at_ms, DATABASE_PERSISTANCE, case, alias=sealed.alias)
        numbers = {} if decided_at_ms is None else {"decided_at_ms": decided_at_ms}
        log.write(done.final_at_ms, BLOCKCHAIN_TRANSACTION, case, alias=sealed.alias, **numbers)


async def note_dropped(clip: SpooledClip, run: RunContext, statistics: RunStatistics) -> None:
    """Consent ended. Raises SPOOL_FULL."""
    run.consents.figures.clips_dropped += 1
    run.open_visits.lower(clip.owner)
    reason, now = str(WithholdReason.NO_CONSENT), run.now_ms()
    for sensor, figures in (*statistics.senses.items(), (DEPTH, statistics)):
        dropped = figures.clip_dropped(clip.upload.record_id, reason)
        for sequence, _ in dropped.frames:
            run.log.write_withheld(now, sensor, sequence, alias=dropped.alias, reason=reason)
    await asyncio.to_thread(run.open_visits.save)
