"""The whole robot on bad recordings: every usable frame is accounted for, the rest is counted, nothing is half-written."""

from __future__ import annotations

import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.sensing.input_checks import REFUSED_IN_A_ROW_MAX_COUNT
from clients.robot.sensing.message_names import DEPTH_TOPIC, EMPTY_TOPIC, IMAGE_TYPE, SIGHTING_TOPIC, SIGHTING_TYPE
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import parse_scenario
from tests.unit.clients.robot.sources.recordings import START_MS, Topic, image, record, storage_file
from tests.unit.clients.robot.test_pipeline import Robot, roster
from tests.unit.clients.robot.test_senses import SCENE, tag_messages
from tests.virtual_time import run_virtual

Messages = list[tuple[int, Mapping[str, Any]]]
FRAMES = 30


@pytest.fixture(scope="module")
def depth() -> Messages:
    renderer = Renderer(parse_scenario(SCENE))
    return [(at * 100, image(renderer.frame(at), at_ms=START_MS + at * 100)) for at in range(FRAMES)]


@pytest.fixture(scope="module")
def empty() -> Messages:
    renderer = Renderer(parse_scenario(SCENE))
    return [(at, image(renderer.empty_frame(at + 1), at_ms=START_MS)) for at in range(3)]


def run(folder: Path, depth: Messages, empty: Messages, tags: Messages | None = None, kind: str = "ros1") -> Robot:
    topics = [
        Topic(EMPTY_TOPIC, IMAGE_TYPE, empty),
        Topic(DEPTH_TOPIC, IMAGE_TYPE, depth),
        Topic(SIGHTING_TOPIC, SIGHTING_TYPE, tag_messages(parse_scenario(SCENE)) if tags is None else tags),
    ]
    return run_over(folder, record(folder / "bag", kind, topics))


def run_over(folder: Path, recording: Path) -> Robot:
    robot = Robot(folder, recording, roster(), topics=parse_topics("[depth]\nfocal_px = 262"))
    run_virtual(robot.run())
    return robot


def check_whole(robot: Robot) -> FrameCounts:
    """Hold that nothing is lost, waiting or open; return the counts of frames."""
    counts = robot.statistics.count_frames()
    assert counts.lost == 0
    assert counts.kept + counts.withheld == counts.covered
    assert robot.spool.names() == []
    owners = list(robot.network.records.values())
    assert robot.network.closed == {owner: owners.count(owner) for owner in set(owners)}
    assert len(robot.network.records) == robot.statistics.records_final
    return counts


def test_bad_frames_between_good_ones_cost_nothing_but_themselves(
    tmp_path: Path, depth: Messages, empty: Messages
) -> None:
    rng = random.Random(5)
    changes = [
        {"encoding": "bgr8"},
        {"step": 3},
        {"data": np.ones(7, np.uint8)},
        {"height": 120, "data": depth[0][1]["data"][:76_800]},
    ]
    bad = [(at * 100 + 50, {**depth[at][1], **rng.choice(changes)}) for at in range(FRAMES)]
    robot = run(tmp_path, [*depth, *bad], empty)
    counts = check_whole(robot)
    assert counts.published == counts.covered == FRAMES
    assert counts.kept > FRAMES / 2
    refused = robot.inputs.summarise_refused()["frame"]
    assert sum(refused.values()) == FRAMES
    assert set(refused) == {"encoding", "step", "size"}


@pytest.mark.parametrize("value", [0, 65_535, 1])
def test_frames_that_measure_nothing_or_nonsense_are_withheld_and_the_others_kept(
    tmp_path: Path, depth: Messages, empty: Messages, value: int
) -> None:
    dead = [
        (at * 100 + 50, image(np.full((240, 320), value, np.uint16), at_ms=START_MS + at * 100 + 50))
        for at in range(9, 12)
    ]
    counts = check_whole(run(tmp_path, [*depth, *dead], empty))
    assert counts.published == FRAMES + 3
    assert counts.withheld >= 3
    assert counts.kept > FRAMES / 2


def test_metres_with_nothing_but_nan_are_frames_without_anybody(tmp_path: Path, empty: Messages) -> None:
    nan = np.full((240, 320), np.nan, np.float32)
    frames = [(at * 100, image(nan, "32FC1", START_MS + at * 100)) for at in range(FRAMES)]
    counts = check_whole(run(tmp_path, frames, empty))
    assert (counts.covered, counts.kept) == (FRAMES, 0)


def test_frames_of_one_stamp_are_kept_once_and_withheld_after_that(
    tmp_path: Path, depth: Messages, empty: Messages
) -> None:
    twice = [*depth, *[(at + 1, fields) for at, fields in depth]]
    counts = check_whole(run(tmp_path, twice, empty))
    assert counts.published == 2 * FRAMES
    assert counts.withheld_reasons["disordered"] == FRAMES
    assert counts.kept > FRAMES / 2


def test_a_camera_that_is_gone_for_twenty_seconds_is_taken_up_again(
    tmp_path: Path, depth: Messages, empty: Messages
) -> None:
    later = [
        (at + 20_000, {**fields, "header": image(np.ones((1, 1), np.uint16), at_ms=START_MS + at + 20_000)["header"]})
        for at, fields in depth
    ]
    tags = tag_messages(parse_scenario(SCENE))
    again = [(at + 20_000, _later(fields, 20_000)) for at, fields in tags]
    counts = check_whole(run(tmp_path, [*depth, *later], empty, [*tags, *again]))
    assert counts.published == counts.covered == 2 * FRAMES
    assert counts.kept > FRAMES


def test_a_reader_that_is_gone_for_twenty_seconds_leaves_the_time_between_to_nobody(
    tmp_path: Path, empty: Messages
) -> None:
    renderer = Renderer(parse_scenario(SCENE))
    frames = [(at * 500, image(renderer.frame(min(at, 29)), at_ms=START_MS + at * 500)) for at in range(60)]
    tags = tag_messages(parse_scenario(SCENE))[:3]
    again = [(at + 25_000, _later(fields, 25_000)) for at, fields in tags]
    counts = check_whole(run(tmp_path, frames, empty, [*tags, *again]))
    assert counts.published == 60
    assert counts.covered == sum(1 for at in range(60) if at * 500 <= 5_250 or at * 500 >= 20_050)


def _later(fields: Mapping[str, Any], by_ms: int) -> dict[str, Any]:
    def moved(stamp: Mapping[str, int]) -> dict[str, int]:
        at_ms = stamp["sec"] * 1000 + stamp["nanosec"] // 1_000_000 + by_ms
        return {"sec": at_ms // 1000, "nanosec": at_ms % 1000 * 1_000_000}

    return {
        **fields,
        "header": {"stamp": moved(fields["header"]["stamp"]), "frame_id": ""},
        "first_seen": moved(fields["first_seen"]),
        "last_seen": moved(fields["last_seen"]),
    }


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
@pytest.mark.parametrize("share", [0.7, 0.9])
def test_a_recording_that_breaks_off_is_recorded_up_to_the_break_and_no_further(
    tmp_path: Path, depth: Messages, empty: Messages, kind: str, share: float
) -> None:
    topics = [
        Topic(EMPTY_TOPIC, IMAGE_TYPE, empty),
        Topic(DEPTH_TOPIC, IMAGE_TYPE, depth),
        Topic(SIGHTING_TOPIC, SIGHTING_TYPE, tag_messages(parse_scenario(SCENE))),
    ]
    path = record(tmp_path / "bag", kind, topics)
    file = storage_file(path)
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    robot = run_over(tmp_path, path)
    counts = check_whole(robot)
    assert 0 < counts.published < FRAMES
    assert counts.covered == counts.published
    assert robot.inputs.fault is not None
    assert robot.inputs.fault.code == "BAG_DAMAGED"


def test_a_camera_that_only_sends_rubbish_ends_the_run_with_what_came_before_kept(
    tmp_path: Path, depth: Messages, empty: Messages
) -> None:
    rubbish = [
        (4_000 + at, {**image(np.ones((2, 2), np.uint16)), "encoding": "yuv422"})
        for at in range(REFUSED_IN_A_ROW_MAX_COUNT + 9)
    ]
    robot = run(tmp_path, [*depth, *rubbish], empty)
    counts = check_whole(robot)
    assert counts.kept > FRAMES / 2
    assert robot.inputs.fault is not None
    assert robot.inputs.fault.code == "FRAMES_UNUSABLE"
    assert robot.inputs.refused == {"frame": {"encoding": REFUSED_IN_A_ROW_MAX_COUNT}}
