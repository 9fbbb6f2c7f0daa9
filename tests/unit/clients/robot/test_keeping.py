"""Between hiding and sealing: whatever waits for somebody is kept or dropped by what she says at that moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clients.robot.consent.consent_view import STALE_AFTER_MS
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import KeptFrame, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.recording.batching import ReadyClip
from clients.robot.recording.event_log import EventLog, read_events
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import RunContext, SensorRecorder
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import VisitKeyring
from clients.robot.run.pipeline import note_dropped
from clients.robot.sensing.sensor_clocks import ClockEstimator
from consensus.members.roster import ROSTER_VERSION, Roster, RosterRow
from consensus.primitives.keys import PrivateKey
from tests.unit.clients.robot.counted import note
from tests.unit.clients.robot.registry_stand_in import ROBOT, RegistryStandIn, consents_on
from tests.unit.clients.robot.test_spool import KEY, clip
from tests.virtual_time import in_virtual_time, virtual_now_ms

pytestmark = pytest.mark.usefixtures("inline_threads")

ANN, BEN = b"a" * 32, b"b" * 32
CLIP_MS = 500


def row(handle: bytes) -> RosterRow:
    keys = [PrivateKey(bytes([number]) * 32).public_key for number in (3, 4)]
    return RosterRow(tag=handle, handle=handle, spend=keys[0], view=keys[1], sealing=b"X" * 32, proof=b"")


class RecordingHarness:
    """A track with ann and ben in the picture; both consent to it."""

    def __init__(self, folder: Path) -> None:
        self.roster = Roster(ROSTER_VERSION, bytes(32), ROBOT.public_key, bytes(32), 0, 1 << 50, (row(ANN), row(BEN)))
        self.registry = RegistryStandIn(self.roster, virtual_now_ms)
        for handle in (ANN, BEN):
            self.registry.say(handle)
        self.consents = consents_on(self.registry, self.roster)
        self.statistics = RunStatistics(window_ms=5_000)
        self.log_path = folder / "events.jsonl"
        self.log = EventLog(self.log_path)
        self.visits = VisitKeyring(bytes(32), ROBOT.public_key, "demo")
        self.run = RunContext(
            consents=self.consents,
            visits=self.visits,
            open_visits=UnclosedVisitStore(folder / "open-visits", KEY),
            log=self.log,
            clip_ms=CLIP_MS,
            now_ms=virtual_now_ms,
        )
        self.people = {"ann": row(ANN), "ben": row(BEN)}
        self.track = SensorRecorder(self.run, "depth", self.people, self.statistics)
        self.consents.on_change = self.track.drop_refused

    def kept(self, sequence: int, alias: str = "ann", taken_at_ms: int | None = None) -> list[ReadyClip]:
        at_ms = virtual_now_ms() if taken_at_ms is None else taken_at_ms
        return self.track.process(KeptFrame(sequence, at_ms, alias, EncodedCutout(0, 0, 1, 1, b"png")))

    def withheld(self, sequence: int, alias: str = "ann") -> list[ReadyClip]:
        return self.track.process(WithheldFrame(sequence, virtual_now_ms(), alias, WithholdReason.CONTACT))

    def flush(self) -> dict[str, tuple[list[int], dict[str, int]]]:
        """What may be sealed now of all that waits: sequences and withheld counts by alias."""
        admitted = [self.track.admit(ready) for ready in self.track.batcher.flush()]
        return {
            ready.alias: ([frame.sequence for frame in ready.frames], dict(ready.withheld))
            for ready in admitted
            if ready is not None
        }

    def logged(self) -> list[tuple[str, str, str]]:
        return [
            (event.case, event.alias, event.detail["reason"])
            for event in read_events(self.log_path)
            if event.activity == "IMAGE_WITHHELD"
        ]


@in_virtual_time
async def at_the_desk(folder: Path, story: Callable[[RecordingHarness], Any]) -> None:
    desk = RecordingHarness(folder)
    await desk.consents.refresh()
    await asyncio.sleep(0.01)
    with desk.log:
        await story(desk)


def test_while_consent_holds_everything_is_kept_and_the_owner_told(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        assert desk.track.is_tag_allowed(row(ANN), virtual_now_ms())
        desk.withheld(1)
        desk.kept(2)
        assert desk.flush() == {"ann": ([2], {"contact": 1})}
        assert desk.statistics.withheld == {"contact": 1}

    at_the_desk(tmp_path, story)


def test_what_comes_out_of_hiding_after_a_no_is_not_kept_whenever_it_was_taken(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        taken_ms = virtual_now_ms()
        await asyncio.sleep(1)
        desk.registry.say(ANN, "withdrawn")
        await desk.consents.refresh()
        assert desk.kept(1, taken_at_ms=taken_ms) == []
        desk.withheld(2)
        desk.kept(3, "ben")
        assert desk.flush() == {"ben": ([3], {})}
        assert desk.statistics.withheld == {"no-consent": 2}
        assert desk.logged() == [("frame-1", "ann", "no-consent"), ("frame-2", "ann", "no-consent")]

    at_the_desk(tmp_path, story)


def test_what_waits_in_an_open_clip_is_dropped_as_soon_as_the_no_is_seen(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.kept(1)
        desk.kept(2)
        desk.kept(1, "ben")
        desk.registry.say(ANN, "refused")
        await desk.consents.refresh()
        assert desk.statistics.withheld == {"no-consent": 2}
        assert desk.track.batcher.drop("ann") == [], "nothing is left to wait for the clip's end"
        assert desk.flush() == {"ben": ([1], {})}

    at_the_desk(tmp_path, story)


def test_a_clip_that_is_ready_when_the_no_comes_is_not_sealed(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.kept(1)
        (ready,) = desk.track.batcher.flush()
        desk.registry.say(ANN, "withdrawn")
        await desk.consents.refresh()
        assert desk.track.admit(ready) is None
        assert desk.statistics.withheld == {"no-consent": 1}

    at_the_desk(tmp_path, story)


def test_somebody_who_said_no_is_sent_no_word_of_what_was_withheld_either(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.withheld(1)
        (ready,) = desk.track.batcher.flush()
        desk.registry.say(ANN, "withdrawn")
        await desk.consents.refresh()
        assert desk.track.admit(ready) is None
        assert desk.flush() == {}

    at_the_desk(tmp_path, story)


def test_whoever_consents_again_is_in_a_new_visit(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.kept(1)
        first = desk.visits.chain_for("ann", row(ANN), virtual_now_ms())
        desk.registry.say(ANN, "withdrawn")
        await desk.consents.refresh()
        desk.registry.say(ANN)
        await desk.consents.refresh()
        await asyncio.sleep(0.01)
        desk.kept(2)
        assert desk.flush() == {"ann": ([2], {})}
        assert desk.visits.chain_for("ann", row(ANN), virtual_now_ms()).owner != first.owner

    at_the_desk(tmp_path, story)


def test_a_no_and_a_yes_between_two_readings_end_the_visit_too(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.kept(1)
        first = desk.visits.chain_for("ann", row(ANN), virtual_now_ms())
        await asyncio.sleep(1)
        await desk.consents.refresh()
        assert desk.visits.chain_for("ann", row(ANN), virtual_now_ms()) is first, "nothing was said"
        desk.registry.say(ANN, "withdrawn")
        desk.registry.say(ANN)
        await desk.consents.refresh()
        await asyncio.sleep(0.01)
        desk.kept(2)
        assert desk.flush() == {"ann": ([2], {})}
        assert desk.visits.chain_for("ann", row(ANN), virtual_now_ms()).owner != first.owner

    at_the_desk(tmp_path, story)


def test_a_no_to_one_sensor_leaves_the_visit_of_another_alone(tmp_path: Path) -> None:
    """A track that never kept anything of her ends nothing."""

    async def story(desk: RecordingHarness) -> None:
        rgb = SensorRecorder(desk.run, "rgb", desk.people, RunStatistics(window_ms=5_000))
        first = desk.visits.chain_for("ann", row(ANN), virtual_now_ms())
        for _ in range(3):
            rgb.drop_refused()
        assert desk.visits.chain_for("ann", row(ANN), virtual_now_ms()) is first

    at_the_desk(tmp_path, story)


def test_while_the_view_is_stale_tags_count_as_unknown_and_what_waits_is_withheld_and_told(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.kept(1)
        desk.registry.failure = "NODE_UNREACHABLE"
        await asyncio.sleep(STALE_AFTER_MS / 1000 + 5)
        assert not desk.track.is_tag_allowed(row(ANN), virtual_now_ms())
        desk.kept(2)
        desk.withheld(3)
        assert desk.flush() == {}
        assert desk.statistics.withheld == {"registry-stale": 2, "contact": 1}
        assert desk.consents.figures.sightings_refused == {"registry-stale": 1}
        desk.registry.failure = ""
        await desk.consents.refresh()
        assert desk.track.is_tag_allowed(row(ANN), virtual_now_ms())
        desk.kept(4)
        assert desk.flush() == {"ann": ([4], {"contact": 1, "registry-stale": 2})}

    at_the_desk(tmp_path, story)


def test_a_consent_that_has_not_begun_is_counted_apart_from_a_no(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        desk.registry.say(BEN, "withdrawn")
        desk.registry.say(ANN, "withdrawn")
        await desk.consents.refresh()
        desk.registry.say(ANN, height=desk.registry.height + 5)
        await desk.consents.refresh()
        for handle in (ANN, ANN, BEN):
            assert not desk.track.is_tag_allowed(row(handle), virtual_now_ms())
        assert desk.consents.figures.sightings_refused == {"consent-coming": 2, "no-consent": 1}

    at_the_desk(tmp_path, story)


def test_the_end_of_a_period_parts_a_clip(tmp_path: Path) -> None:
    """What was taken in time is sealed, also afterwards; what was taken later is not."""

    async def story(desk: RecordingHarness) -> None:
        until = virtual_now_ms() - virtual_now_ms() % 300_000 + 300_000
        desk.registry.say(ANN, until_ms=until)
        await desk.consents.refresh()
        await asyncio.sleep((until - virtual_now_ms()) / 1000 + 2)
        await desk.consents.refresh()
        desk.kept(1, taken_at_ms=until - 100)
        desk.kept(2, taken_at_ms=until + 100)
        assert desk.flush() == {"ann": ([1], {})}
        assert desk.statistics.withheld == {"outside-consent": 1}
        assert not desk.track.is_tag_allowed(row(ANN), virtual_now_ms())

    at_the_desk(tmp_path, story)


def test_a_camera_whose_clock_is_off_is_judged_by_the_robots_own(tmp_path: Path) -> None:
    """Stamps an hour ahead are not of a time after a consent that was given this minute, nor stamps behind before it."""

    async def story(desk: RecordingHarness) -> None:
        given_ms = virtual_now_ms()
        desk.registry.say(ANN, "withdrawn")
        desk.registry.say(ANN)
        await desk.consents.refresh()
        for offset_ms in (-3_600_000, 0, 3_600_000):
            desk.run.clocks.camera = ClockEstimator()
            desk.run.clocks.camera.observe(given_ms - offset_ms, given_ms)
            assert desk.track.is_tag_allowed(row(ANN), given_ms + 1_000 - offset_ms)
            assert not desk.track.is_tag_allowed(row(ANN), given_ms - 1_000 - offset_ms)
            desk.kept(1, taken_at_ms=given_ms - 1_000 - offset_ms)
            desk.kept(2, taken_at_ms=given_ms + 1_000 - offset_ms)
            assert desk.flush() == {"ann": ([2], {})}

    at_the_desk(tmp_path, story)


def test_a_clip_that_was_destroyed_is_counted_and_its_visit_has_a_record_less(tmp_path: Path) -> None:
    async def story(desk: RecordingHarness) -> None:
        visits = desk.run.open_visits
        sealed = clip(7)
        note(visits, sealed.owner, 2)
        desk.statistics.clip_sealed(sealed.upload.record_id, [(5, 100), (6, 133)], "ann")
        for _ in range(3):  # a clip of an earlier run has no frames that this one knows
            await note_dropped(sealed, desk.run, desk.statistics)
        assert desk.statistics.withheld == {"no-consent": 2}
        assert desk.logged() == [("frame-5", "ann", "no-consent"), ("frame-6", "ann", "no-consent")]
        assert desk.consents.summarise().clips_dropped == 3
        assert visits.counts == UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {sealed.owner: 0}
        sound = RunStatistics(window_ms=5_000)
        desk.statistics.senses["audio"] = sound
        sound.clip_sealed(clip(8).upload.record_id, [(3, 100)], "ann")
        await note_dropped(clip(8), desk.run, desk.statistics)
        assert (sound.withheld, desk.statistics.withheld) == ({"no-consent": 1}, {"no-consent": 2})
        told = [event for event in read_events(desk.log_path) if event.activity == "SENSE_WITHHELD"]
        assert [(event.case, event.alias) for event in told] == [("audio-3", "ann")]

    at_the_desk(tmp_path, story)
