"""The whole robot on a small recording, in virtual time: every frame accounted for, nothing said that must not be."""

from __future__ import annotations

import asyncio
import itertools
import secrets
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from nacl.public import PrivateKey as SealingPrivateKey

from clients.robot.consent.consent_view import Consents
from clients.robot.delivery.delivery import Delivery
from clients.robot.hiding.background import empty_bank, learn_background
from clients.robot.hiding.frame_redactor import FrameRedactor
from clients.robot.pairing.input_throttle import PipelineIntake
from clients.robot.pairing.rosters import RosterBook, UnknownTagCounts
from clients.robot.recording.event_log import EventLog, read_events
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import RunContext
from clients.robot.recording.spool import Delivered, Spool
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import VisitKeyring
from clients.robot.run.pipeline import Pipeline, note_delivered, note_dropped
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sensing.input_checks import Inputs
from clients.robot.sensing.sensor_events import Frame, Sighting, SourceEvent
from clients.robot.sources.messages.topics import Topics
from clients.robot.sources.recordings.bag_source import BagSource
from consensus.members.roster import ROSTER_VERSION, Roster, RosterRow, roster_tag
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import open_metadata
from consensus.records.metadata import RecordMetadata, find_chain_gaps
from tests.unit.clients.robot.registry_stand_in import SIGNER, RegistryStandIn, consents_on
from tests.unit.clients.robot.test_delivery import FakeNetwork
from tests.unit.clients.robot.test_spool import KEY
from tests.virtual_time import run_virtual, virtual_now_ms

UID = "E200000000000001"
CHAIN = bytes(range(32))
ROBOT = PrivateKey(bytes([5] * 32))
DAY_MS = 24 * 3600 * 1000
ANN = SealingPrivateKey(bytes([12] * 32))


def roster() -> Roster:
    key = bytes([4] * 32)
    row = RosterRow(
        tag=roster_tag(key, UID),
        handle=b"HANDLE" * 5 + b"HA",
        spend=PrivateKey(secrets.token_bytes(32)).public_key,
        view=PrivateKey(secrets.token_bytes(32)).public_key,
        sealing=bytes(ANN.public_key),
        proof=b"",
    )
    return Roster(ROSTER_VERSION, CHAIN, ROBOT.public_key, key, 0, 1 << 50, (row,))


class Robot:
    """One run over a recording."""

    live = False

    def __init__(
        self,
        folder: Path,
        recording: Path,
        known: Roster,
        clip_ms: int = 200,
        purposes: tuple[str, ...] = ("demo",),
        *,
        sensors: tuple[str, ...] = ("depth",),
        topics: Topics | None = None,
        chain: bytes = CHAIN,
    ) -> None:
        self.chain = chain
        self.network = FakeNetwork()
        self.statistics = RunStatistics(window_ms=5_000)
        self.log_path = folder / "events.jsonl"
        self.spool = Spool(folder / "spool", KEY)
        self.open_visits = UnclosedVisitStore(folder / "open-visits", KEY)
        self.source = BagSource(recording, topics=topics)
        self.sensors = sensors
        self.inputs: Inputs
        self.known = known
        self.clip_ms = clip_ms
        self.delivered: list[Delivered] = []
        self.purposes = purposes
        self.registry: RegistryStandIn
        self.consents: Consents
        self.intake: PipelineIntake

    async def run(self) -> None:
        empty = self.source.empty_frames()
        height, width = empty[0].shape
        self.registry = RegistryStandIn(self.known, virtual_now_ms)
        for row in self.known.rows:
            for purpose, sensor in itertools.product(self.purposes, self.sensors):
                self.registry.say(row.handle, purpose=purpose, sensor=sensor, since_ms=virtual_now_ms() - DAY_MS)
        self.consents = consents_on(self.registry, self.known)
        await self.consents.refresh()
        with EventLog(self.log_path) as log:

            def note(done: Delivered) -> None:
                self.delivered.append(done)
                note_delivered(done, self.statistics, log)

            run = RunContext(
                consents=self.consents,
                visits=VisitKeyring(self.chain, ROBOT.public_key, "demo"),
                open_visits=self.open_visits,
                log=log,
                clip_ms=self.clip_ms,
                now_ms=virtual_now_ms,
            )
            delivery = Delivery(
                self.spool,
                self.network,
                on_delivered=note,
                may_record_clip=self.consents.may_record_clip,
                on_dropped=lambda clip: note_dropped(clip, run, self.statistics),
                at_once=True,
            )
            pipeline = Pipeline(
                run=run,
                empty_frames=tuple(empty_bank(empty)),
                redactor=FrameRedactor(learn_background(empty), focal_px=self.source.focal_px or FOCAL_DEFAULT_PX),
                roster=RosterBook(self.known, SIGNER),
                spool=self.spool,
                delivery=delivery,
                statistics=self.statistics,
            )
            self.source.shift_to(virtual_now_ms())
            watch = asyncio.create_task(self.consents.watch())
            try:
                self.inputs = Inputs((height, width))
                await pipeline.run(self.inputs.usable(self.events()), live=self.live)
                self.intake = pipeline.summarise_intake()
            finally:
                watch.cancel()
                await delivery.stop()

    async def events(self) -> AsyncIterator[SourceEvent]:
        for event in self.source.events():
            await asyncio.sleep(0)
            yield event


@pytest.fixture
def ran(tmp_path: Path, small_bag: Path) -> Robot:
    robot = Robot(tmp_path, small_bag, roster())
    run_virtual(robot.run())
    return robot


def test_the_recording_has_what_this_file_needs(small_bag: Path) -> None:
    events = list(BagSource(small_bag).events())
    assert sum(isinstance(event, Frame) for event in events) >= 6
    assert {event.uid for event in events if isinstance(event, Sighting)} == {UID}


def test_every_covered_frame_is_final_or_withheld(ran: Robot) -> None:
    counts = ran.statistics.count_frames()
    assert counts.published >= 6
    assert counts.covered > 0
    assert counts.lost == 0
    assert counts.kept + counts.withheld == counts.covered


def test_everything_is_on_the_chain_and_every_visit_closed_with_its_count(ran: Robot) -> None:
    assert ran.spool.names() == []
    per_owner = {owner: list(ran.network.records.values()).count(owner) for owner in set(ran.network.records.values())}
    assert per_owner
    assert ran.network.closed == per_owner


def test_the_owner_can_read_the_whole_visit_and_is_told_what_was_withheld(ran: Robot) -> None:
    metas = [decode(open_metadata(bytes(ANN), done.clip.sealed_metadata), RecordMetadata) for done in ran.delivered]
    metas.sort(key=lambda meta: meta.index_in_visit)
    assert find_chain_gaps(metas) == []
    told: dict[str, int] = {}
    for meta in metas:
        for reason, count in meta.withheld:
            told[reason] = told.get(reason, 0) + count
    assert told == ran.statistics.withheld


def test_no_line_of_the_log_holds_a_uid_a_handle_or_an_owner_key(ran: Robot) -> None:
    text = ran.log_path.read_text(encoding="utf-8").lower()
    owners = {done.clip.owner.hex() for done in ran.delivered}
    assert owners
    records = {done.clip.upload.record_id.hex() for done in ran.delivered}
    for secret in (UID, UID.encode().hex(), (b"HANDLE" * 5 + b"HA").hex(), "handle", *owners, *records):
        assert secret.lower() not in text


def test_the_log_tells_the_papers_story(ran: Robot) -> None:
    activities = [event.activity for event in read_events(ran.log_path)]
    assert activities.count("IMAGE_RETRIEVE") == ran.statistics.published
    assert activities.count("IMAGE_PAIRED") == ran.statistics.covered
    assert activities.count("BLOCKCHAIN_TRANSACTION") == ran.statistics.kept_final
    assert activities.count("DATABASE_PERSISTANCE") == ran.statistics.kept_final
    assert activities.count("IMAGE_WITHHELD") == ran.statistics.withheld_count


def test_every_frame_that_is_kept_goes_the_whole_way_in_the_log_under_one_alias(ran: Robot) -> None:
    ways: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for event in read_events(ran.log_path):
        if event.case.startswith("frame-"):
            ways.setdefault((event.case, event.alias), []).append((event.time_ms, event.activity))
    kept = [way for way in ways.values() if way[-1][1] == "BLOCKCHAIN_TRANSACTION"]
    assert len(kept) == ran.statistics.kept_final
    for way in kept:
        assert [name for _, name in way] == ["IMAGE_PAIRED", "DATABASE_PERSISTANCE", "BLOCKCHAIN_TRANSACTION"]
        assert way == sorted(way, key=lambda step: step[0])


def test_a_tag_that_is_on_no_roster_is_recorded_by_nobody(tmp_path: Path, small_bag: Path) -> None:
    known = roster()
    stranger = Roster(ROSTER_VERSION, CHAIN, ROBOT.public_key, bytes([9] * 32), 0, 1 << 50, known.rows)
    robot = Robot(tmp_path, small_bag, stranger)
    run_virtual(robot.run())
    assert robot.network.calls == []
    assert robot.statistics.covered == 0
    assert {event.activity for event in read_events(robot.log_path)} >= {"IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID"}
    readings = sum(isinstance(event, Sighting) for event in robot.source.events())
    assert robot.intake.unknown_tags == UnknownTagCounts(readings=readings, tags=1, more_tags=False)


def test_whoever_did_not_consent_to_the_purpose_is_not_recorded(tmp_path: Path, small_bag: Path) -> None:
    robot = Robot(tmp_path, small_bag, roster(), purposes=("research",))
    run_virtual(robot.run())
    assert robot.network.calls == []
    assert robot.network.uploads == {}


def test_clips_that_waited_from_the_run_before_are_delivered_first(tmp_path: Path, small_bag: Path) -> None:
    first = Robot(tmp_path, small_bag, roster())
    first.network.refusals = ["SENDER_NOT_ADMITTED"] * 100
    with pytest.raises(Exception, match="SENDER_NOT_ADMITTED"):
        run_virtual(first.run())
    waiting = len(first.spool.names())
    assert waiting > 0
    second = Robot(tmp_path, small_bag, roster())
    run_virtual(second.run())
    assert second.spool.names() == []
    assert len(second.network.records) >= waiting + 1
    assert second.statistics.count_frames().lost == 0


def test_a_visit_that_a_killed_robot_left_open_is_closed_by_the_next_run_with_its_count(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise its owner could never know whether its last records are missing."""
    first = Robot(tmp_path, small_bag, roster())

    async def killed_here(*_arguments: object) -> None:
        raise ChildProcessError("killed")

    with monkeypatch.context() as patch:
        patch.setattr(Delivery, "close_visit", killed_here)
        with pytest.raises(ChildProcessError):
            run_virtual(first.run())
    assert first.network.closed == {}
    counts = {owner: list(first.network.records.values()).count(owner) for owner in first.network.visits}
    second = Robot(tmp_path, small_bag, roster(), purposes=("research",))
    second.network = first.network
    run_virtual(second.run())
    assert counts
    assert second.network.closed == counts
    assert UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {}
