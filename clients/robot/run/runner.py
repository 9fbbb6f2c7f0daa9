"""Assembles a run: recording, roster, pipeline, delivery, summary."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
from msgspec import UNSET

from clients.robot.backgrounds.background_banks import approved_frames, approved_scene, check_empty, published_frames
from clients.robot.backgrounds.background_publishing import publish_frames
from clients.robot.consent.consent_view import Consents, compute_stale_after_ms
from clients.robot.consent.registry_reader import NetworkMajority, RegistryReader
from clients.robot.delivery.delivery import Delivery
from clients.robot.delivery.robot_network import COPIES_DEFAULT_COUNT, RobotNetwork
from clients.robot.hiding.background import Background, empty_bank, learn_background
from clients.robot.hiding.frame_redactor import FrameRedactor
from clients.robot.hiding.moving.driving_figures import NO_FLOOR, DrivingFigures
from clients.robot.hiding.moving.moving_hider import DrivingCamera
from clients.robot.identity.robot_keys import load_identity
from clients.robot.pairing.rosters import load_roster
from clients.robot.recording.event_log import MESSAGE_REFUSED, EventLog
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import RunContext
from clients.robot.recording.spool import Spool
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import VisitKeyring
from clients.robot.run.pipeline import Pipeline, note_delivered, note_dropped
from clients.robot.run.run_summary import RunIntake, RunProgress, RunSummary
from clients.robot.run.run_validity import RunValidity
from clients.robot.sensing.camera_intrinsics import CameraFigures, CameraIntrinsics
from clients.robot.sensing.input_checks import Inputs
from clients.robot.sensing.sensor_events import RefusedMessage, SourceEvent
from clients.robot.sources.live.live_source import LiveSource
from clients.robot.sources.messages.topics import Topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import Source, StoppableClock
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.terminal.json_answers import extend
from clients.sdk.trust_pin import PIN_FILE
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

SPOOL_FOLDER = "spool"
FRESH_WITHIN_MS = 30_000
"""How long a run waits for a recent block at most, beyond the chain's heartbeat."""

_NOBODY_KNOWN = (
    "The chain confirms nobody of the roster, so nothing will be kept. Make it with everybody whose tag is to count: "
    "blockrobot roster make."
)
_START_DELAY_MS = 250
_PROGRESS_EVERY_S = 0.25
LOCK_FILE = "robot.lock"


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """With `viewpoint` the approved bank supplies empty frames. `lasts_s`: source seconds in real time; `copies`: required
    custodians (or all); `passphrase`: key file's; `approver`: admin key that approves empty frames; `tell` hears notices.
    """

    roster: Path
    purpose: str
    clip_ms: int
    events: Path
    at_once: bool
    real_time: bool
    viewpoint: str = ""
    lasts_s: float | None = None
    copies: int = COPIES_DEFAULT_COUNT
    passphrase: str | None = field(default=None, repr=False)
    approver: PrivateKey | None = field(default=None, repr=False)
    tell: Callable[[str], None] = field(default=lambda _sentence: None, repr=False)


class ProgressListener(Protocol):
    """Receives a run's progress figures."""

    def __call__(self, figures: RunProgress, *, last: bool = False) -> None: ...


async def _events(
    source: Source, stop: asyncio.Event, options: ReplayOptions, tenure: RunValidity
) -> AsyncIterator[SourceEvent]:
    if options.real_time:
        ends_ms = None if options.lasts_s is None else source.start_ms + round(options.lasts_s * 1000)
        async for event in source.play(StoppableClock(stop, ends_ms)):
            if stop.is_set() or tenure.is_over:
                break
            yield event
    else:
        for event in source.events():
            if stop.is_set() or tenure.is_over:
                break
            yield event
    tenure.check()


def _note_refused(refused: RefusedMessage, count: int, log: EventLog, now_ms: int) -> None:
    case = f"{refused.kind}-refused-{log.counts[MESSAGE_REFUSED]}"
    if count == 1:
        log.write(now_ms, MESSAGE_REFUSED, case, reason=refused.reason)
    else:
        log.write(now_ms, MESSAGE_REFUSED, case, reason=refused.reason, count=count)


def _redactor_of(source: Source, background: Background) -> FrameRedactor:
    topics = source.topics if isinstance(source, LiveSource | BagSource) else Topics()
    driving, odometry = None, topics.odometry
    if odometry is not None:
        driving = DrivingCamera(None, odometry.keep, odometry.camera_ahead_m, odometry.camera_left_m)
    return FrameRedactor(
        background, driving=driving, time_of_flight=topics.time_of_flight, antenna_pairs=topics.antenna_pairs
    )


def _summarise_intake(source: Source, pipeline: Pipeline, inputs: Inputs) -> RunIntake:
    unnamed = source.antennas_unnamed if isinstance(source, LiveSource | BagSource) else None
    return extend(
        RunIntake,
        pipeline.summarise_intake(),
        messages_refused=inputs.summarise_refused(),
        first_refused=dict(inputs.first_detail),
        fault=inputs.summarise_fault(),
        antennas_unnamed=UNSET if unnamed is None else {topic: dict(counts) for topic, counts in unnamed.items()},
        **(source.count_intake()._asdict() if isinstance(source, LiveSource) else {}),
    )


class _Run:
    def __init__(
        self,
        folder: Path,
        client: NetworkClient,
        options: ReplayOptions,
        progress: ProgressListener,
        stop: asyncio.Event | None = None,
    ) -> None:
        self._folder = folder
        self._options = options
        self._progress = progress
        self._stop = stop or asyncio.Event()
        self._over = asyncio.Event()
        self._identity = load_identity(folder, options.passphrase)
        self._client = client
        self._chain_id = client.genesis.chain_id
        self._network = RobotNetwork(client, self._identity, options.copies)
        self._roster = load_roster(options.roster, self._identity, self._chain_id, self._network.now_ms())
        self._spool = Spool(folder / SPOOL_FOLDER, self._identity.spool)
        self._consents = Consents(
            RegistryReader(client, self._identity.identity, self._roster),
            self._roster,
            majority=NetworkMajority(client, self._identity.identity),
            person_key=self._identity.spool,
            stale_after_ms=lambda: compute_stale_after_ms(self._heartbeat_ms),
            now_ms=self._network.now_ms,
            tell=options.tell,
        )

    async def work(self, source: Source) -> RunSummary:
        """First requires a recent block. Raises REGISTRY_STALE."""
        await self._consents.refresh()
        watch = asyncio.create_task(self._consents.watch())
        try:
            await self._consents.wait_fresh(self._heartbeat_ms + FRESH_WITHIN_MS)
            if not len(self._consents):
                self._options.tell(_NOBODY_KNOWN)
            return await self._play(source)
        finally:
            watch.cancel()

    def _tenure(self) -> RunValidity:
        viewpoint, now_ms = self._options.viewpoint, self._network.now_ms
        look = (lambda: approved_scene(self._folder, viewpoint, now_ms())) if viewpoint else None
        return RunValidity(self._roster, now_ms, look)

    async def _play(self, source: Source) -> RunSummary:
        viewpoint, now_ms, tenure = self._options.viewpoint, self._network.now_ms(), self._tenure()
        empty = approved_frames(self._folder, viewpoint, now_ms) if viewpoint else source.empty_frames()
        check_empty(empty)
        bank = tuple(empty_bank(published_frames(empty)))
        background = learn_background(empty)
        redactor = _redactor_of(source, background)
        lens = CameraIntrinsics(source, redactor.use_focal_px, live=isinstance(source, LiveSource))
        if redactor.lacks_floor:
            self._options.tell(NO_FLOOR)
        statistics = RunStatistics(window_ms=redactor.pairing.window_ms)
        open_visits = UnclosedVisitStore(self._folder / "open-visits", self._identity.spool)
        member = self._identity.identity.public_key
        await publish_frames(self._network, bank, self._folder, member, self._options.approver)
        with EventLog(self._options.events) as log:
            run = RunContext(
                consents=self._consents,
                visits=VisitKeyring(self._chain_id, member, self._options.purpose),
                open_visits=open_visits,
                log=log,
                clip_ms=self._options.clip_ms,
                now_ms=self._network.now_ms,
            )
            delivery = Delivery(
                self._spool,
                self._network,
                on_delivered=lambda done: note_delivered(done, statistics, log),
                may_record_clip=self._consents.may_record_clip,
                on_dropped=lambda clip: note_dropped(clip, run, statistics),
                at_once=self._options.at_once,
            )
            pipeline = Pipeline(
                run=run,
                empty_frames=bank,
                redactor=redactor,
                roster=self._roster,
                spool=self._spool,
                delivery=delivery,
                statistics=statistics,
            )
            source.shift_to(self._network.now_ms() + _START_DELAY_MS)
            inputs = Inputs(
                background.shape,
                lambda refused, count: _note_refused(refused, count, log, self._network.now_ms()),
                live=isinstance(source, LiveSource),
            )
            events = inputs.usable(lens.learnt(_events(source, self._over, self._options, tenure)))
            beside = [
                asyncio.create_task(self._report_regularly(statistics)),
                asyncio.create_task(tenure.watch(self._over.set)),
                asyncio.create_task(self._watch_for_stop()),
            ]
            try:
                await pipeline.run(events, live=self._options.real_time)
            finally:
                for task in beside:
                    task.cancel()
                await delivery.stop()
                inputs.close()
            self._report_progress(statistics, last=True)
        intake = _summarise_intake(source, pipeline, inputs)
        return self._summarise(statistics, intake, lens.summarise(), redactor.summarise_driving())

    def _summarise(
        self, statistics: RunStatistics, intake: RunIntake, camera: CameraFigures, driving: DrivingFigures | None
    ) -> RunSummary:
        return RunSummary(
            roster_rows=len(self._consents),
            consents=self._consents.summarise(),
            frames=statistics.count_frames(),
            ambiguous=statistics.summarise_ambiguous(),
            merged=statistics.summarise_merged(),
            distances_off=statistics.summarise_distances_off(),
            senses=statistics.count_senses(),
            latency_ms=statistics.summarise_latencies(),
            hiding_ms=statistics.hiding.summarise(),
            intake=intake,
            camera=camera,
            driving=driving,
            records=statistics.records_final,
            stored_bytes=statistics.stored_bytes,
            spool_peak_bytes=self._spool.peak_bytes,
            uploads_refused=dict(sorted(self._network.refused_uploads.items())),
            final_gap_max_s=round(statistics.final_gap_max_ms / 1000, 3),
        )

    @property
    def _heartbeat_ms(self) -> int:
        return self._client.light_client.epoch.settings.heartbeat_ms

    async def _watch_for_stop(self) -> None:
        await self._stop.wait()
        self._over.set()

    async def _report_regularly(self, statistics: RunStatistics) -> None:
        while True:
            self._report_progress(statistics, last=False)
            await asyncio.sleep(_PROGRESS_EVERY_S)

    def _report_progress(self, statistics: RunStatistics, *, last: bool) -> None:
        figures = RunProgress(
            frames_read=statistics.published,
            frames_recorded=statistics.kept_final,
            records=statistics.records_final,
            waiting=len(self._spool.names()),
        )
        self._progress(figures, last=last)


async def replay_recording(
    folder: Path,
    source: Source,
    genesis: Genesis,
    options: ReplayOptions,
    progress: ProgressListener,
    stop: asyncio.Event | None = None,
) -> RunSummary:
    """Return the summary once records are final; `stop` ends the source early.

    Raises ROBOT_RUNNING, EMPTY_SCENE_MISSING, EMPTY_FRAME_NOT_APPROVED, BACKGROUND_*, BAG_*, ROSTER_*, SPOOL_*,
    REGISTRY_STALE, network errors.
    """
    # Picture work runs in one thread next to the nodes; a pool of OpenCV's own would only fight them for cores.
    cv2.setNumThreads(1)
    with lock_robot(folder):
        async with open_pinned_client(genesis, folder / PIN_FILE) as client:
            run = _Run(folder, client, options, progress, stop)
            return await run.work(source)


@contextlib.contextmanager
def lock_robot(folder: Path) -> Iterator[None]:
    """Hold a robot's lock. Raises ROBOT_RUNNING, ROBOT_NOT_FOUND."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except FileNotFoundError:
        raise BlockRobotError("ROBOT_NOT_FOUND", f"There is no robot in {folder}.") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockRobotError("ROBOT_RUNNING", f"The robot in {folder} runs already.") from None
        yield
    finally:
        os.close(descriptor)
