"""What a recording is said to hold, and the topics file that is drafted from it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.sources.listing import describe, draft_topics, list_topics
from clients.robot.sources.recording import Recording
from clients.robot.sources.topics import parse_topics
from clients.robot.topics_cli import topics
from tests.unit.clients.robot.sources.recordings import FORMATS, Topic, image, record, storage_file

TYPES = {
    "ward_msgs/msg/Tag": "string epc\nuint8 antenna\nfloat32 rssi_dbm\nfloat32 range_cm",
    "ward_msgs/msg/TagArray": "std_msgs/Header header\nward_msgs/Tag[] tags",
}
DEPTH = np.full((4, 6), 1500, np.uint16)
EPC = "E280116060000001"


@pytest.fixture(params=FORMATS)
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    colour = np.zeros((4, 6, 3), np.uint8)
    tags = [(i * 100, {"tags": [{"epc": EPC, "antenna": 1, "rssi_dbm": -40.0, "range_cm": 180.0}]}) for i in range(11)]
    found = [
        Topic("/kinect/depth", "sensor_msgs/msg/Image", [(i * 100, image(DEPTH)) for i in range(11)]),
        Topic("/kinect/rgb", "sensor_msgs/msg/Image", [(0, image(colour, "rgb8"))]),
        Topic("/kinect/mystery", "sensor_msgs/msg/Image", [(0, image(DEPTH, "bayer_rggb16"))]),
        Topic("/rfid", "ward_msgs/msg/TagArray", tags),
        Topic("/emotion", "std_msgs/msg/String", [(0, {"data": "calm"})]),
        Topic("/chatter", "std_msgs/msg/String", [(0, {"data": EPC})]),
        Topic("/pose", "geometry_msgs/msg/Pose2D", [(0, {})]),
    ]
    return record(tmp_path / "bag", request.param, found, TYPES)


def test_each_topic_is_listed_with_what_it_could_be(recording: Path) -> None:
    listed = {item.figures.name: item for item in list_topics(Recording(recording))}
    assert {name: item.could_be for name, item in listed.items()} == {
        "/chatter": ("tags", "labels"),
        "/emotion": ("labels",),
        "/kinect/depth": ("depth",),
        "/kinect/mystery": (),
        "/kinect/rgb": ("rgb",),
        "/pose": (),
        "/rfid": ("tags",),
    }
    assert listed["/kinect/mystery"].encoding == "bayer_rggb16"
    assert (listed["/rfid"].figures.count, listed["/rfid"].figures.rate_hz) == (11, pytest.approx(11, abs=0.1))


def test_nothing_that_a_message_says_is_shown(recording: Path) -> None:
    opened = Recording(recording)
    assert EPC not in describe(opened) + draft_topics(opened, list_topics(opened))


def test_a_draft_is_a_topics_file_that_finds_fields_in_nested_messages(recording: Path) -> None:
    opened = Recording(recording)
    only = [item for item in list_topics(opened) if item.figures.name != "/chatter"]
    drafted = parse_topics(draft_topics(opened, only))
    assert drafted.depth == "/kinect/depth"
    assert drafted.tags[0].map.epc == "tags[].epc"
    assert drafted.tags[0].map.rssi == "tags[].rssi_dbm"
    assert "not named so far: tags[].range_cm" in draft_topics(opened, only)


def test_the_command_lists_drafts_once_and_says_where_a_recording_breaks_off(recording: Path, tmp_path: Path) -> None:
    draft = str(tmp_path / "topics.toml")
    done = CliRunner().invoke(topics, [str(recording), "--draft", draft])
    assert done.exit_code == 0
    assert "/kinect/depth" in done.output
    again = CliRunner().invoke(topics, [str(recording), "--draft", draft, "--json"])
    assert again.exit_code != 0
    assert json.loads(again.output)["error"]["code"] == "TOPICS_INVALID"
    file = storage_file(recording)
    file.write_bytes(file.read_bytes()[:-40])
    told = json.loads(CliRunner().invoke(topics, [str(recording), "--json"]).output)
    assert told["ok"] is True
    assert {row["topic"] for row in told["topics"]} >= {"/rfid", "/emotion"}
