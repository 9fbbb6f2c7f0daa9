"""What a robot's middleware hands over: messages in CDR or ROS 1's form, and definitions of types."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from rosbags.typesys.store import Typestore

from clients.robot.sensing.message_names import DEPTH_TOPIC, SIGHTING_DEFINITION, SIGHTING_TYPE, typestore
from clients.robot.sources.messages.decoding import MessageReader, read_focal_px
from clients.robot.sources.messages.message_types import LearntTypes, Message, MessageTypes
from clients.robot.sources.messages.topics import SIGHTING_TOPIC, LabelTopic, Topics
from tests.fuzz.target import Target, refusing
from tests.unit.clients.robot.sources.recordings import START_MS, build, image, stamp

IMAGE, COMPRESSED, STRING = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "std_msgs/msg/String"
INFO = "sensor_msgs/msg/CameraInfo"
_RED, _LABELS = "/rgb", "/labels"


def open_ros() -> Target:
    """Messages and definitions of a live feed: the first byte says what the rest is (ROS 1 or CDR, and the type)."""
    store = typestore()
    kinds = (IMAGE, COMPRESSED, SIGHTING_TYPE, STRING, INFO)
    topics = Topics(rgb=_RED, labels=LabelTopic(_LABELS, "data", ""))
    of_type = {
        IMAGE: (DEPTH_TOPIC, _RED),
        COMPRESSED: (DEPTH_TOPIC, _RED),
        SIGHTING_TYPE: (SIGHTING_TOPIC,),
        STRING: (_LABELS,),
    }
    readers = [MessageTypes(store, ros1=ros1) for ros1 in (False, True)]

    def read(types: MessageTypes, type_name: str, body: bytes) -> None:
        for topic in of_type.get(type_name, ()):
            made = MessageReader(topics).read(Message(topic, type_name, START_MS * 1_000_000, body), types)
            assert made
        if type_name == INFO:
            read_focal_px(types.decode(Message("/camera_info", INFO, 0, body)))

    def run(data: bytes) -> None:
        mode, body = (data[0] if data else 0), data[1:]
        with refusing("FRAME_INVALID", "TOPICS_INVALID"):
            if mode < 2 * len(kinds):
                read(readers[mode % 2], kinds[mode // 2], body)
                return
            learnt = LearntTypes(store, ros1=bool(mode % 2))
            definition, _, message = body.partition(b"\0")
            text = definition.decode("utf-8", "replace")
            if learnt.learn(SIGHTING_TYPE, text):
                types = learnt.of(SIGHTING_TYPE)
                types.paths(SIGHTING_TYPE)
                types.decode(Message(SIGHTING_TOPIC, SIGHTING_TYPE, 0, message))

    return Target("ros", _ros_seeds(store, kinds), run, None, 16 * 1024)


def _ros_seeds(store: Typestore, kinds: tuple[str, ...]) -> list[bytes]:
    pixels = np.full((4, 6), 1500, np.uint16)
    grey = np.full((4, 6, 3), 90, np.uint8)
    png = bytes(cv2.imencode(".png", pixels)[1])
    jpeg = bytes(cv2.imencode(".jpg", grey)[1])
    values: dict[str, list[dict[str, Any]]] = {
        IMAGE: [image(pixels), image(pixels.astype(np.float32) / 1000, "32FC1"), image(grey, "rgb8")],
        COMPRESSED: [
            {
                "header": stamp(START_MS),
                "format": "16UC1; compressedDepth",
                "data": np.frombuffer(bytes(12) + png, np.uint8),
            },
            {"header": stamp(START_MS), "format": "rgb8; jpeg compressed", "data": np.frombuffer(jpeg, np.uint8)},
        ],
        SIGHTING_TYPE: [{"header": stamp(START_MS), "epc": "E200", "distance": 1.5, "distance_sigma": 0.1}],
        STRING: [{"data": "a chair"}],
        INFO: [],
    }
    seeds = [
        bytes([2 * place]) + bytes(store.serialize_cdr(build(store, kind, fields), kind))
        for place, kind in enumerate(kinds)
        for fields in values[kind]
    ]
    nested = (
        "geometry_msgs/Pose2D[] poses\nstring<=8 name\nuint8[4] four\n"
        + "=" * 80
        + "\nMSG: geometry_msgs/Pose2D\nfloat64 x\n"
    )
    return [
        *seeds,
        bytes([2 * len(kinds)]) + SIGHTING_DEFINITION.encode(),
        bytes([2 * len(kinds) + 1]) + nested.encode(),
    ]
