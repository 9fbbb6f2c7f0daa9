"""Colour, estimates and sound from a recording to the wallet: each shows one person and nobody else, or is withheld."""

from __future__ import annotations

import asyncio
import json
import wave
from collections import Counter
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from clients.robot.recording import waiting_samples
from clients.robot.sensing.message_names import DEPTH_TOPIC, EMPTY_TOPIC, IMAGE_TYPE, SIGHTING_TOPIC, SIGHTING_TYPE
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario, parse_scenario
from clients.robot.synthetic.tag_readings import readings
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.records.picture_files import write_pictures
from clients.wallet.records.viewing import RecordViewer
from consensus.members.roster import Roster
from tests.unit.clients.robot.sources.recordings import START_MS, Topic, image, record, stamp
from tests.unit.clients.robot.test_pipeline import ROBOT, UID, Robot, roster
from tests.virtual_time import run_virtual
from tests.walking_alone import walking_alone
from tests.world.dicts import World

SCENE = walking_alone(
    "senses",
    3.0,
    [(0.0, -0.5, 2.5), (3.0, -0.2, 2.0)],
    [0.05, 2.95],
    frame_rate=10,
    size=(320, 240),
    focal_px=262.0,
    also_every_s=0.1,
    distance_sigma_m=0.2,
)
VISITOR = """
[[people]]
alias = "ben"
height_m = 1.8
girth = 1.0
cadence = 1.1
path = [[0.0, 1.1, 4.0], [3.0, 0.9, 3.6]]
"""
SENSORS = ("depth", "rgb", "emotion", "audio")
RED, BLUE, GREEN = (200, 0, 0), (0, 0, 200), (0, 200, 0)
TOPICS = """
[depth]
focal_px = 262

[rgb]
topic = "/rgb"
registered = {registered}

[labels]
topic = "/emotion"

[audio]
topic = "/audio"
rate_hz = 8000
"""
AUDIO = {"audio_msgs/msg/Audio": "std_msgs/Header header\nint16[] data"}


def make(folder: Path, *, visitor: bool = False, more: Sequence[Topic] = ()) -> Path:
    """Record a scene with colour (a person red, a visitor blue, the room green), an estimate and sound each second."""
    scenario = parse_scenario(SCENE + (VISITOR if visitor else ""))
    renderer = Renderer(scenario)
    depth, colour = [], []
    for index in range(scenario.frame_count):
        frame, labels = renderer.frame_with_truth(index)
        at = index * 100
        depth.append((at, image(frame, at_ms=START_MS + at)))
        painted = np.full((*frame.shape, 3), GREEN, np.uint8)
        for number, paint in ((1, RED), (2, BLUE)):
            painted[labels == number] = paint
        colour.append((at, image(painted, "rgb8", START_MS + at)))
    empty = [(at, image(renderer.empty_frame(at), at_ms=START_MS - 100)) for at in (1, 2, 3)]
    seconds = range(500, 3_000, 500)
    samples = (np.sin(np.arange(1_600) / 5) * 9_000).astype(np.int16)
    topics = [
        Topic(DEPTH_TOPIC, IMAGE_TYPE, depth),
        Topic(EMPTY_TOPIC, IMAGE_TYPE, empty),
        Topic(SIGHTING_TOPIC, SIGHTING_TYPE, tag_messages(scenario)),
        Topic("/rgb", IMAGE_TYPE, colour),
        Topic("/emotion", "std_msgs/msg/String", [(at, {"data": "calm"}) for at in seconds]),
        Topic(
            "/audio",
            "audio_msgs/msg/Audio",
            [(at, {"header": stamp(START_MS + at), "data": samples}) for at in seconds],
        ),
        *more,
    ]
    return record(folder / "bag", "mcap", topics, AUDIO)


def tag_messages(scenario: Scenario, uid: str = UID) -> list[tuple[int, dict[str, Any]]]:
    """Return the readings of a scene as messages."""
    found = []
    for reading in readings(scenario):
        at = round(reading.at_s * 1000)
        fields = {
            "header": stamp(START_MS + at),
            "epc": uid,
            "antenna": reading.antenna,
            "antenna_facing": reading.facing.value,
            "rssi": reading.rssi_dbm,
            "distance": reading.distance_m,
            "distance_sigma": reading.sigma_m,
            "first_seen": stamp(START_MS + at)["stamp"],
            "last_seen": stamp(START_MS + at)["stamp"],
            "read_count": 1,
        }
        found.append((at, fields))
    return found


def run(
    folder: Path, world: World, recording: Path, *, registered: bool = True, sensors: tuple[str, ...] = SENSORS
) -> Robot:
    """Let the robot work through a recording of the wallet's person."""
    topics = parse_topics(TOPICS.format(registered=str(registered).lower()))
    chain = world.genesis.chain_id
    robot = Robot(folder, recording, belonging_to(world), 500, sensors=sensors, topics=topics, chain=chain)
    run_virtual(robot.run())
    return robot


def belonging_to(world: World) -> Roster:
    """A roster whose one person is the wallet's."""
    known = roster()
    row = msgspec.structs.replace(
        known.rows[0],
        spend=world.keys.spend.public_key,
        view=world.keys.view.public_key,
        sealing=world.keys.sealing_public,
    )
    return msgspec.structs.replace(known, rows=(row,))


async def files_of(world: World, robot: Robot, out: Path) -> dict[str, list[Path]]:
    """Let the wallet fetch, check and write every record; return the files by sensor."""
    found: dict[str, list[Path]] = {}
    for done in robot.delivered:
        world.hold(done.clip, ROBOT.public_key)
    for report in await world.wallet.records():
        for entry in report.records:
            found.setdefault(entry.metadata.sensor, []).extend(await _written(world, entry, out))
    return found


async def _written(world: World, entry: RecordEntry, out: Path) -> list[Path]:
    viewing = RecordViewer(world.wallet)
    view = await viewing.view(entry, await viewing.request_access([entry], "own-access"))
    assert view.corrupted == []
    return [] if entry.metadata.sensor == "depth" else await write_pictures(viewing, view, out)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("alone"))


@pytest.fixture(scope="module")
def visited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("visited"), visitor=True)


@pytest.fixture
def world(tmp_path: Path) -> World:
    (tmp_path / "wallet").mkdir()
    return World(tmp_path / "wallet")


def told_of(world: World, robot: Robot) -> Counter[str]:
    """Return what the wallet's records say was withheld, by reason."""
    for done in robot.delivered:
        world.hold(done.clip, ROBOT.public_key)
    told: Counter[str] = Counter()
    for report in asyncio.run(world.wallet.records()):
        for entry in report.records:
            told.update(dict(entry.metadata.withheld))
    return told


def shares(paths: list[Path]) -> dict[str, float]:
    """Return the share of each painted colour among all painted pixels of some pictures."""
    counts = dict.fromkeys(("red", "blue", "green"), 0)
    for path in paths:
        pixels = np.asarray(cv2.imread(str(path)))[..., ::-1].astype(int)
        for name, paint in {"red": RED, "blue": BLUE, "green": GREEN}.items():
            counts[name] += int((np.abs(pixels - paint).max(axis=2) < 40).sum())
    whole = sum(counts.values())
    return {name: count / whole for name, count in counts.items()}


def test_someone_alone_keeps_estimates_sound_and_her_own_pixels_in_colour(
    tmp_path: Path, world: World, alone: Path
) -> None:
    robot = run(tmp_path, world, alone)
    figures = robot.statistics.count_senses()
    for sensor in ("rgb", "emotion", "audio"):
        assert figures[sensor].kept >= 2, (sensor, figures)
        assert figures[sensor].lost == 0
    files = asyncio.run(files_of(world, robot, tmp_path / "out"))
    assert len(files["rgb"]) == figures["rgb"].kept
    assert all(path.name.endswith(".rgb.png") for path in files["rgb"])
    found = shares(files["rgb"])
    assert found["blue"] == 0
    assert found["red"] > 0.95  # the rest is the room at her edges, where the camera's own noise is
    assert [json.loads(path.read_bytes()) for path in files["emotion"]] == [{"label": "calm"}] * figures["emotion"].kept
    with wave.open(BytesIO(files["audio"][0].read_bytes())) as sound:
        assert (sound.getframerate(), sound.getnframes(), sound.getsampwidth()) == (8_000, 1_600, 2)


def test_colour_that_is_not_registered_is_kept_whole_while_she_is_alone(
    tmp_path: Path, world: World, alone: Path
) -> None:
    robot = run(tmp_path, world, alone, registered=False)
    files = asyncio.run(files_of(world, robot, tmp_path / "out"))
    assert len(files["rgb"]) == robot.statistics.count_senses()["rgb"].kept >= 2
    assert all(path.name.endswith(".rgb.jpg") for path in files["rgb"])
    found = shares(files["rgb"])
    assert found["blue"] == 0
    assert min(found["red"], found["green"]) > 0.01


def test_beside_a_visitor_only_her_own_pixels_are_kept_and_nothing_that_could_be_the_visitors(
    tmp_path: Path, world: World, visited: Path
) -> None:
    robot = run(tmp_path, world, visited)
    figures = robot.statistics.count_senses()
    assert figures["rgb"].kept >= 2
    for sensor in ("emotion", "audio"):
        assert (figures[sensor].kept, figures[sensor].lost) == (0, 0)
        assert set(figures[sensor].withheld_reasons) <= {"not-alone", "not-matched"}
    files = asyncio.run(files_of(world, robot, tmp_path / "out"))
    found = shares(files["rgb"])
    assert found["blue"] == 0
    assert found["red"] > 0.95  # the rest is the room at her edges, where the camera's own noise is
    assert "emotion" not in files
    whole = run(tmp_path / "again", world, visited, registered=False)
    assert whole.statistics.count_senses()["rgb"].kept == 0


def test_a_strangers_tag_in_range_withholds_what_is_not_hers_alone(tmp_path: Path, world: World) -> None:
    stranger = parse_scenario(SCENE)
    more = [Topic("/other_reader", SIGHTING_TYPE, tag_messages(stranger, "E2FFFFFFFFFF")[:3])]
    recording = make(tmp_path, more=more)
    topics = parse_topics(
        TOPICS.format(registered="true")
        + "".join(
            f"[[tags]]\ntopic = '{topic}'\nepc = 'epc'\nantenna = 'antenna'\nfacing = 'antenna_facing'\n"
            "distance = 'distance'\ndistance_sigma = 'distance_sigma'\ndistance_unit = 'm'\n"
            for topic in (SIGHTING_TOPIC, "/other_reader")
        )
    )
    robot = Robot(tmp_path, recording, belonging_to(world), 500, sensors=SENSORS, topics=topics)
    run_virtual(robot.run())
    figures = robot.statistics.count_senses()
    assert figures["emotion"].kept == 0
    assert figures["emotion"].withheld_reasons == {"not-alone": 5}


def test_a_sense_without_consent_leaves_no_trace(tmp_path: Path, world: World, alone: Path) -> None:
    robot = run(tmp_path, world, alone, sensors=("depth", "emotion"))
    figures = robot.statistics.count_senses()
    assert figures["emotion"].kept >= 2
    assert (figures["rgb"].kept, figures["audio"].kept) == (0, 0)
    files = asyncio.run(files_of(world, robot, tmp_path / "out"))
    assert set(files) <= {"depth", "emotion", "notice"}


def test_the_owner_is_told_how_much_of_a_sense_was_withheld_and_none_is_plain_on_the_disk(
    tmp_path: Path, world: World, alone: Path
) -> None:
    robot = run(tmp_path, world, alone)
    statistics = [robot.statistics, *robot.statistics.senses.values()]
    assert sum(told_of(world, robot).values()) == sum(each.withheld_count for each in statistics)
    assert robot.statistics.count_senses()["emotion"].kept >= 2
    for path in [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".mcap"]:
        assert b"calm" not in path.read_bytes()


def test_what_there_was_no_memory_for_is_withheld_and_its_owner_told(
    tmp_path: Path, world: World, alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows yet whose a picture is when memory runs out, so the owner hears of it once that is decided."""
    monkeypatch.setattr(waiting_samples, "WAITING_MAX_BYTES", 8_000)
    robot = run(tmp_path, world, alone)
    figures = robot.statistics.count_senses()
    assert robot.statistics.count_frames().kept > 10
    assert figures["rgb"].dropped > 20
    assert figures["rgb"].withheld_reasons == {"no-room": figures["rgb"].dropped}
    assert all(figures[sensor].lost == 0 for sensor in ("rgb", "emotion", "audio"))
    assert told_of(world, robot)["no-room"] == sum(each.dropped for each in figures.values())


def test_what_came_first_is_kept_when_memory_runs_out_and_the_largest_sense_gives_way(
    tmp_path: Path, world: World, alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Letting go what has waited longest would keep nothing at all, were more to come always than memory holds."""
    monkeypatch.setattr(waiting_samples, "WAITING_MAX_BYTES", 30_000)
    robot = run(tmp_path, world, alone, registered=False)
    figures = robot.statistics.count_senses()
    assert figures["rgb"].dropped > 0
    assert figures["rgb"].kept > 0
    assert figures["emotion"].dropped == 0
    assert figures["emotion"].kept >= 2


def test_more_messages_of_a_sense_than_may_wait_are_withheld_as_well(
    tmp_path: Path, world: World, alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting_samples, "WAITING_MAX_COUNT", 10)
    robot = run(tmp_path, world, alone)
    figures = robot.statistics.count_senses()
    assert figures["rgb"].dropped == figures["rgb"].withheld_reasons["no-room"] == 20
    assert figures["rgb"].kept == 10
    assert figures["emotion"].dropped == 0
