"""A recording or a node that has its own idea of ROS: other types, other columns. It is refused, and the run goes on."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clients.robot.sensing.message_names import DEPTH_TOPIC, SIGHTING_TYPE, typestore
from clients.robot.sensing.sensor_events import RefusedMessage
from clients.robot.sources.messages.decoding import MessageReader, read_focal_px
from clients.robot.sources.messages.message_types import LearntTypes, Message
from clients.robot.sources.messages.topics import SIGHTING_TOPIC, Topics
from clients.robot.sources.recordings.bag_source import BagSource
from consensus.errors import BlockRobotError
from tests.fuzz.target import refusing
from tests.unit.clients.robot.sources.recordings import START_MS, Topic, image, record, stamp, storage_file

IMAGE = "sensor_msgs/msg/Image"
RGB = "/camera/rgb"
CDR = b"\0\1\0\0"
OTHER_IMAGES = [
    ("uint32 height\n", CDR + bytes(4)),
    ("string height\nuint32 width\nuint32 step\nstring encoding\nuint8 is_bigendian\nuint8[] data\n", CDR),
    ("string header\nstring encoding\n", CDR + b"\6\0\0\0mono8\0"),
    ("uint32[] encoding\nuint8[] data\n", CDR + bytes(8)),
    ("float64 format\nfloat64 data\n", CDR + bytes(4) + b"\0\0\0\0\0\0\xf8\x7f" * 2),
]


@pytest.mark.parametrize("topic", [DEPTH_TOPIC, RGB])
@pytest.mark.parametrize(("definition", "data"), OTHER_IMAGES)
def test_an_image_with_other_fields_than_ros_gives_it_is_refused(topic: str, definition: str, data: bytes) -> None:
    learnt = LearntTypes(typestore(), ros1=False)
    assert learnt.learn(IMAGE, definition)
    reader = MessageReader(Topics(rgb=RGB))
    (made,) = reader.read(Message(topic, IMAGE, START_MS * 1_000_000, data), learnt.of(IMAGE))
    assert isinstance(made, RefusedMessage)


@pytest.mark.parametrize("told", [{}, {"k": "none"}, {"k": 5}, {"K": [b""]}, {"k": []}, {"k": [10**400]}])
def test_a_focal_length_that_is_no_number_is_none(told: dict[str, Any]) -> None:
    assert read_focal_px(SimpleNamespace(**told)) is None


def test_a_recording_that_leaves_a_field_out_refuses_those_messages_and_has_no_empty_scene(tmp_path: Path) -> None:
    pixels = image(np.full((4, 6), 1500, np.uint16))
    tag = {"header": stamp(START_MS), "epc": "E200"}
    topics = [Topic(DEPTH_TOPIC, IMAGE, [(0, pixels)]), Topic(SIGHTING_TOPIC, SIGHTING_TYPE, [(1, tag)])]
    path = storage_file(record(tmp_path / "bag", "mcap", topics))
    whole = path.read_bytes()
    assert whole.count(b"uint32 step") >= 1
    path.write_bytes(whole.replace(b"uint32 step", b"uint32 stop"))
    source = BagSource(path)
    assert [type(event) is RefusedMessage for event in source.events()] == [True, False]
    with pytest.raises(BlockRobotError, match=r"^EMPTY_SCENE_MISSING:"):
        source.empty_frames()


@pytest.mark.parametrize(
    "written",
    [
        "UPDATE topics SET name = x'00ff' WHERE id = 1",
        "UPDATE topics SET type = x'01' WHERE id = 2",
        "UPDATE messages SET timestamp = 'soon'",
        "UPDATE messages SET timestamp = 1.5e300",
        "UPDATE messages SET data = 'text'",
    ],
)
def test_a_database_whose_columns_hold_something_else_is_refused(tmp_path: Path, written: str) -> None:
    pixels = image(np.full((4, 6), 1500, np.uint16))
    tag = {"header": stamp(START_MS), "epc": "E200"}
    topics = [Topic(DEPTH_TOPIC, IMAGE, [(0, pixels)]), Topic(SIGHTING_TOPIC, SIGHTING_TYPE, [(1, tag)])]
    path = storage_file(record(tmp_path / "bag", "sqlite3", topics))
    with closing(sqlite3.connect(path)) as base, base:
        base.execute(written)
    with refusing("BAG_DAMAGED", "BAG_TOPIC_MISSING", "TOPICS_INVALID"):
        assert all(isinstance(event, RefusedMessage) for event in BagSource(path).events())
