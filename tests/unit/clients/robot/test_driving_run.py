"""A run of a robot that drives: who is known from when it stood is recorded on the way, without the room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from clients.robot.cli.reading_warnings import warn_of_odometry
from clients.robot.cli.run_report import summary_lines
from clients.robot.hiding import frame_redactor
from clients.robot.hiding.moving.driving_figures import NO_FLOOR, DrivingFigures
from clients.robot.run.run_summary import RunSummary
from clients.robot.sources.messages.topics import OdometryTopic, Topics, load_topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.driving.drive_file import DRIVE_TOPICS_FILE, load_shipped_scene
from clients.robot.synthetic.scenario_bag import make_bag
from consensus.records.envelopes import open_data_key, open_frame
from consensus.records.renditions import NO_BACKGROUND, decode_rendition
from tests.unit.clients.robot.run_summaries import FRAMES, summary_of
from tests.unit.clients.robot.test_pipeline import ANN, UID
from tests.unit.clients.robot.test_replay_start import Start, begin

FIGURES = DrivingFigures(
    keep=True,
    places=900,
    doubts=0,
    home_lost=False,
    frames=40,
    kept=30,
    unplaced_readings=0,
    camera_height_m=1.2,
    camera_pitch_deg=4.0,
)

Play = Callable[[Topics], tuple[RunSummary, list[bool]]]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drive = load_shipped_scene("demo-drive")
    return make_bag(drive, {"patient-b": UID}, tmp_path_factory.mktemp("bags"), workers=1)


@pytest.fixture
def play(tmp_path: Path, bag: Path, monkeypatch: pytest.MonkeyPatch, inline_threads: None) -> Play:
    """Return a run's summary, and of each recorded picture whether it shows the room."""

    def played(topics: Topics) -> tuple[RunSummary, list[bool]]:
        found: list[tuple[RunSummary, list[bool]]] = []

        async def story(start: Start) -> None:
            start.registry.block()
            start.registry.idle = False
            summary = await start.run.work(BagSource(bag, topics=topics))
            found.append((summary, _rooms_in(start)))

        begin(tmp_path, bag, monkeypatch, story)
        return found[0]

    return played


def _rooms_in(start: Start) -> list[bool]:
    rooms = []
    for record_id, upload in start.network.uploads.items():
        for index, (ciphertext, sealed_key) in enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True)):
            plaintext = open_frame(open_data_key(bytes(ANN), sealed_key), record_id, index, ciphertext)
            rooms.append(decode_rendition(plaintext).background_id != NO_BACKGROUND)
    return rooms


def test_with_odometry_people_are_kept_on_the_way_and_the_records_say_that_they_show_no_room(play: Play) -> None:
    summary, rooms = play(load_topics(DRIVE_TOPICS_FILE))
    driving = summary.driving
    assert driving is not None
    assert driving.camera_height_m == pytest.approx(1.2, abs=0.2)
    assert (driving.places > 0, driving.doubts) == (True, 0)
    assert 0 < rooms.count(False) == driving.kept <= driving.frames
    assert len(rooms) == summary.frames.kept > driving.kept, "and with the room while it stood"
    assert summary.frames.lost == 0


def test_odometry_that_no_file_names_is_warned_of(bag: Path) -> None:
    unnamed, named = BagSource(bag), BagSource(bag, topics=load_topics(DRIVE_TOPICS_FILE))
    (warning,) = warn_of_odometry(unnamed.unnamed_odometry, unnamed.odometry_rate_hz)
    assert "/odom" in warning
    assert not list(warn_of_odometry(named.unnamed_odometry, named.odometry_rate_hz))


@pytest.mark.parametrize(("rate_hz", "warned"), [(0.0, True), (3.9, True), (4.0, False)])
def test_odometry_that_comes_too_rarely_is_warned_of(rate_hz: float, warned: bool) -> None:
    assert any("places of odometry a second" in warning for warning in warn_of_odometry([], rate_hz)) == warned


def test_a_run_says_at_once_that_the_empty_scene_shows_no_floor(
    tmp_path: Path, bag: Path, monkeypatch: pytest.MonkeyPatch, inline_threads: None
) -> None:
    monkeypatch.setattr(frame_redactor, "measure_mount", lambda _points: None)

    async def story(start: Start) -> None:
        start.registry.block()
        start.stop.set()
        await start.run.work(BagSource(bag, topics=load_topics(DRIVE_TOPICS_FILE)))
        assert start.told == [NO_FLOOR]

    begin(tmp_path, bag, monkeypatch, story)


@pytest.mark.parametrize("topics", [Topics(), replace(Topics(), odometry=OdometryTopic("/odom"))])
def test_unless_it_is_asked_for_nothing_is_kept_on_the_way_and_the_end_says_what_would_help(
    play: Play, topics: Topics
) -> None:
    summary, rooms = play(topics)
    assert (summary.driving is None) == (topics.odometry is None)
    assert all(rooms)
    assert summary.frames.withheld_reasons["moved"] > 0
    assert any("A robot that drives" in line for line in summary_lines(summary))


@pytest.mark.parametrize(
    ("figures", "told"),
    [
        (FIGURES, ["40 frames, 30 kept", "1.20 m above the floor and looks 4 degrees down"]),
        (msgspec.structs.replace(FIGURES, camera_pitch_deg=-4.0), ["looks 4 degrees up"]),
        (msgspec.structs.replace(FIGURES, unplaced_readings=3), ["3 readings bound nobody"]),
        (msgspec.structs.replace(FIGURES, home_lost=True), ["the empty scene was no longer used"]),
        (msgspec.structs.replace(FIGURES, keep=False, home_lost=True), ["the empty scene was no longer used"]),
        (msgspec.structs.replace(FIGURES, doubts=2), ["2 times the camera saw another motion"]),
        (msgspec.structs.replace(FIGURES, places=0), ["No place of odometry came"]),
        (msgspec.structs.replace(FIGURES, keep=False, places=0), ["No place of odometry came"]),
        (msgspec.structs.replace(FIGURES, camera_height_m=None), ["shows no floor"]),
    ],
)
def test_the_end_says_how_it_went_without_the_empty_scene(figures: DrivingFigures, told: list[str]) -> None:
    said = "\n".join(summary_lines(msgspec.structs.replace(summary_of(FRAMES), driving=figures)))
    assert all(words in said for words in told)
