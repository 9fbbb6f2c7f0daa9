"""Antennas that look to different sides: measured by a walk, they tell on which side a tag is, and say nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.cli.antenna_commands import antennas
from clients.robot.cli.robot_choice import RobotPlace
from clients.robot.hiding.background import learn_background
from clients.robot.run.antenna_walk import AntennaWalk
from clients.robot.sensing.antenna_calibration import READINGS_MIN_COUNT, calibrate
from clients.robot.sensing.antenna_pairs import BEARING_MAX_DEG, PAIRED_WITHIN_MS, AntennaBearings, AntennaPair
from clients.robot.sensing.message_names import SIGHTING_TOPIC
from clients.robot.sensing.sensor_events import RSSI_UNKNOWN_DBM, Facing, Sighting
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.scenario import Antenna, Scenario
from clients.robot.synthetic.scenario_bag import make_bag
from clients.robot.synthetic.scenes import draw_scene
from clients.robot.synthetic.tag_readings import readings
from consensus.errors import BlockRobotError
from network.lab.hiding.scenes import ANTENNAS, walk_calibration

PAIR = AntennaPair(1, 2, offset_db=1.0, slope_db_per_deg=0.5, sigma_db=4.0)
TWO = (Antenna(1, -35.0), Antenna(2, 35.0))


def heard(at_ms: int, antenna: int, rssi_dbm: float, origin: str = "/rfid") -> Sighting:
    return Sighting(at_ms, at_ms, "", antenna, Facing.UNKNOWN, rssi_dbm, origin=origin)


def bearings(pairs: list[AntennaPair], *sightings: Sighting) -> list[float | None]:
    located = AntennaBearings(pairs)
    return [located.locate("tag", sighting).bearing_deg for sighting in sightings]


def test_the_second_antenna_that_hears_a_tag_tells_its_side() -> None:
    located = AntennaBearings([PAIR])
    assert located.locate("tag", heard(0, 1, -60.0)).bearing_deg is None
    second = located.locate("tag", heard(40, 2, -49.0))
    assert second.bearing_deg == pytest.approx((11.0 - 1.0) / 0.5)
    assert second.bearing_sigma_deg == pytest.approx(8.0)
    assert bearings([PAIR], heard(0, 2, -60.0), heard(40, 1, -49.0)) == [None, pytest.approx(-24.0)]


@pytest.mark.parametrize(
    "other",
    [
        heard(PAIRED_WITHIN_MS + 1, 2, -50.0),
        heard(40, 3, -50.0),
        heard(40, 1, -50.0),
        heard(40, 2, -50.0, origin="/another"),
        heard(40, 2, RSSI_UNKNOWN_DBM),
    ],
    ids=["later", "an antenna of no pair", "the same antenna", "another reader's antenna", "no RSSI"],
)
def test_what_was_not_heard_by_both_at_one_time_tells_no_side(other: Sighting) -> None:
    assert bearings([PAIR], heard(0, 1, -60.0), other) == [None, None]


def test_a_pair_of_one_reader_tells_nothing_of_anothers_antennas() -> None:
    theirs = [heard(0, 1, -60.0, origin="/another"), heard(40, 2, -50.0, origin="/another")]
    assert bearings([replace(PAIR, reader="/rfid")], *theirs) == [None, None]
    assert bearings([replace(PAIR, reader="/another")], *theirs)[1] is not None


def test_each_reading_makes_one_bearing() -> None:
    found = bearings([PAIR], heard(0, 1, -60.0), heard(40, 2, -50.0), heard(80, 2, -50.0), heard(90, 1, -60.0))
    assert [bearing is not None for bearing in found] == [False, True, False, True]


def test_a_tag_of_another_person_is_no_partner_and_a_bearing_of_the_readers_own_stays() -> None:
    located = AntennaBearings([PAIR])
    located.locate("mine", heard(0, 1, -60.0))
    assert located.locate("theirs", heard(40, 2, -50.0)).bearing_deg is None
    own = replace(heard(40, 2, -50.0), bearing_deg=3.0, bearing_sigma_deg=2.0)
    assert located.locate("mine", own) is own


def test_pairs_that_disagree_are_not_believed() -> None:
    wide = AntennaPair(2, 3, offset_db=0.0, slope_db_per_deg=0.5, sigma_db=6.0)
    located = AntennaBearings([wide, PAIR])
    first = [located.locate("tag", one) for one in (heard(0, 1, -60.0), heard(20, 3, -90.0))]
    assert [one.bearing_deg for one in first] == [None, None]
    assert located.locate("tag", heard(40, 2, -49.0)).bearing_deg is None
    agreed = AntennaBearings([wide, PAIR])
    for one in (heard(0, 1, -60.0), heard(20, 3, -42.0)):
        agreed.locate("tag", one)
    assert agreed.locate("tag", heard(40, 2, -49.0)).bearing_deg == pytest.approx(20.0), "the more exact pair's"


def test_after_the_clock_was_set_back_nothing_from_before_is_a_partner() -> None:
    located = AntennaBearings([PAIR])
    located.locate("tag", heard(0, 1, -60.0))
    located.restart()
    assert located.locate("tag", heard(40, 2, -49.0)).bearing_deg is None


def test_a_bearing_ends_at_the_side() -> None:
    assert bearings([PAIR], heard(0, 1, -90.0), heard(40, 2, -20.0))[1] == BEARING_MAX_DEG


def walk(slope: float, *, count: int = 200, turn_deg: float = 40.0, reflected: float = 0.0, every_ms: int = 500):  # type: ignore[no-untyped-def]
    """A bearer who walks from side to side, and what two antennas hear; a share of it by reflections."""
    rng = np.random.default_rng(3)
    at = np.arange(count) * every_ms
    turn = turn_deg / 2 * np.sin(at / 3_000)
    noise = rng.normal(0, 3.0, count) + 40.0 * (rng.random(count) < reflected)
    contrast = 2.0 + slope * turn + noise
    seen = [(int(ms), float(deg)) for ms, deg in zip(at, turn, strict=True)]
    left = [heard(int(ms), 7, -60.0) for ms in at]
    right = [heard(int(ms) + 40, 8, -60.0 + float(db)) for ms, db in zip(at, contrast, strict=True)]
    return seen, [*left, *right]


def test_a_walk_gives_the_line_back() -> None:
    found = calibrate(*walk(0.6))
    (pair,) = found.pairs
    assert (pair.left, pair.right, pair.reader) == (7, 8, "/rfid")
    assert pair.slope_db_per_deg == pytest.approx(0.6, abs=0.05)
    assert pair.offset_db == pytest.approx(2.0, abs=0.7)
    assert pair.sigma_db == pytest.approx(3.0, abs=0.4)
    assert found.readings == (200,)


def test_antennas_named_the_wrong_way_round_are_turned_round() -> None:
    (pair,) = calibrate(*walk(-0.6)).pairs
    assert (pair.left, pair.right) == (8, 7)
    assert pair.slope_db_per_deg == pytest.approx(0.6, abs=0.05)
    assert pair.offset_db == pytest.approx(-2.0, abs=0.7)


def test_reflections_bend_no_line_but_count_as_its_error() -> None:
    (pair,) = calibrate(*walk(0.6, reflected=0.2)).pairs
    assert pair.slope_db_per_deg == pytest.approx(0.6, abs=0.1)
    assert pair.sigma_db > 10


@pytest.mark.parametrize(
    ("reason", "given"),
    [
        ("few-readings", walk(0.6, count=READINGS_MIN_COUNT - 1)),
        ("little-turn", walk(0.6, turn_deg=12.0)),
        ("no-slope", walk(0.0)),
        ("one-antenna", (walk(0.6)[0], walk(0.6)[1][:200])),
        ("one-antenna", (walk(0.6)[0], [replace(one, rssi_dbm=RSSI_UNKNOWN_DBM) for one in walk(0.6)[1]])),
    ],
)
def test_a_walk_that_tells_nothing_is_refused_with_its_reason(reason: str, given) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(BlockRobotError) as refused:
        calibrate(*given)
    assert (refused.value.code, refused.value.context["reason"]) == ("CALIBRATION_FAILED", reason)


@pytest.mark.parametrize("seed", range(3))
def test_the_judges_antennas_are_measured_as_they_are(seed: int) -> None:
    for antennas_count in (2, 4):
        best = walk_calibration(antennas_count, seed)[0]
        assert {best.left, best.right} == {1, 2}
        assert 6 < best.sigma_deg < 16


def drawn(*, behind: bool) -> Scenario:
    scenario = draw_scene(5, "bearer-behind" if behind else "single")
    return replace(scenario, reader=replace(scenario.reader, antennas=ANTENNAS[4]))


def test_a_drawn_bearer_behind_is_heard_by_the_antennas_that_look_back() -> None:
    owner = [reading for reading in readings(drawn(behind=True)) if reading.alias == "owner"]
    assert {reading.facing for reading in owner} == {Facing.BACK}
    ahead = [reading.facing for reading in readings(drawn(behind=False))]
    assert ahead.count(Facing.FRONT) > 5 * ahead.count(Facing.BACK), "near the robot a tag is heard from behind too"
    rounds = {round(reading.at_s * 2) for reading in owner}
    assert 0 < sum(reading.distance_m is not None for reading in owner) <= len(rounds), "one distance a round"


GOOD = '[[tags]]\ntopic = "/rfid"\nepc = "epc"\nantenna = "antenna"\nrssi = "rssi"\n'
LINES = "[[antenna_pairs]]\nleft = 1\nright = 2\noffset_db = -1.5\nslope_db_per_deg = 0.6\nsigma_db = 5.0\n"


def test_a_topics_file_names_antenna_pairs() -> None:
    assert parse_topics(GOOD + LINES).antenna_pairs == (AntennaPair(1, 2, -1.5, 0.6, 5.0),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LINES.replace("right = 2", "right = 1"), "tells no bearings"),
        (LINES.replace("sigma_db = 5.0", "sigma_db = 50.0"), "tells no bearings"),
        (LINES.replace("0.6", "-0.6"), "slope_db_per_deg must be above 0"),
        (LINES.replace("-1.5", "99"), "offset_db must be between -60 and 60"),
        (LINES.replace("left = 1", 'left = "one"'), "left must be an antenna's number"),
        (LINES.replace("left = 1\n", ""), "left must be an antenna's number"),
        (LINES + 'reader = "/other"\n', "is none of the readers: /rfid"),
        (LINES.replace("offset_db", "ofset_db"), "Did you mean offset_db"),
        (LINES * 33, "more than 32"),
        ("[[tags]]\ntopic = '/deaf'\nepc = 'epc'\n" + LINES + 'reader = "/deaf"\n', "needs antenna and rssi"),
        ('[[llrp]]\nhost = "reader.local"\n' + LINES, "reader is missing"),
    ],
)
def test_antenna_pairs_that_cannot_be_meant_are_refused(text: str, said: str) -> None:
    with pytest.raises(BlockRobotError, match="TOPICS_INVALID") as refused:
        parse_topics(GOOD + text)
    assert said in refused.value.detail


@pytest.fixture(scope="module")
def walk_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute at four frames a second; two antennas ask ten times a second."""
    scene = draw_scene(8, "single", duration_s=60.0, frame_rate=4)
    path = tuple((4.0 * turn, (-0.9, 0.9)[turn % 2], 2.4) for turn in range(16))
    person = replace(scene.people[0], path=path, facing=(), readings_s=(0.05, 59.9), also_every_s=0.1)
    reader = replace(scene.reader, antennas=TWO, late_s=0.0)
    small = replace(scene, name="walk", width=320, height=240, focal_px=262.0, empty_frames=8, people=(person,))
    small = replace(small, reader=reader, digest="walk")
    return make_bag(small, {person.alias: "E200000000000001"}, tmp_path_factory.mktemp("bags"), workers=1)


def call(*words: str, folder: Path):  # type: ignore[no-untyped-def]
    place = RobotPlace(folder, folder / "genesis.json", None)
    return CliRunner().invoke(antennas, list(words), obj=place)


def test_the_command_measures_a_recorded_walk_and_its_lines_are_a_topics_file(walk_bag: Path, tmp_path: Path) -> None:
    topics = tmp_path / "topics.toml"
    topics.write_text("[depth]\ntopic = '/camera/depth/image_raw'\nfocal_px = 262.0\n", encoding="utf-8")
    out = tmp_path / "antennas.toml"
    told = call(str(walk_bag), "--topics", str(topics), "--out", str(out), folder=tmp_path)
    assert told.exit_code == 0, told.output
    text = out.read_text(encoding="utf-8")
    assert text.rstrip() in told.output
    (pair,) = parse_topics(GOOD.replace("/rfid", SIGHTING_TOPIC) + text).antenna_pairs
    assert (pair.left, pair.right) == (1, 2)
    again = call(str(walk_bag), "--topics", str(topics), "--json", folder=tmp_path)
    answer = json.loads(again.output)
    assert answer["pairs"][0]["slope_db_per_deg"] == pair.slope_db_per_deg
    assert 0.4 < pair.slope_db_per_deg < 1.0
    assert answer["file"] is None
    assert "FILE_EXISTS" in call(str(walk_bag), "--topics", str(topics), "--out", str(out), folder=tmp_path).output


def test_the_command_asks_for_a_recording_or_a_source(tmp_path: Path) -> None:
    assert "Give a RECORDING of the walk, or --source" in call(folder=tmp_path).output
    assert "give --viewpoint NAME" in call("--source", "ros1", folder=tmp_path).output


def test_a_walk_in_which_nobody_was_seen_is_refused(small_bag: Path) -> None:
    walk = AntennaWalk(learn_background(BagSource(small_bag).empty_frames()))
    walk.watch(event for event in BagSource(small_bag).events() if isinstance(event, Sighting))
    with pytest.raises(BlockRobotError, match="nobody was seen alone"):
        walk.calibrate()
