"""Recordings of the three formats, as somebody hands them over: the container, its definitions and its messages."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.typesys import get_types_from_msg

from clients.robot.sensing.message_names import DEPTH_TOPIC, EMPTY_TOPIC, SIGHTING_TYPE
from clients.robot.sources.messages import message_types
from clients.robot.sources.messages.topics import SIGHTING_TOPIC
from clients.robot.sources.recordings.bag_source import BagSource
from tests.fuzz.target import Target, refusing
from tests.unit.clients.robot.sources.recordings import FORMATS, START_MS, Topic, image, record, stamp, storage_file

SUFFIXES = (".bag", ".db3", ".mcap")
READ_CODES = ("BAG_DAMAGED", "BAG_TOPIC_MISSING", "EMPTY_SCENE_MISSING", "RECORDING_TOO_LARGE", "TOPICS_INVALID")
EVENTS_MAX_COUNT = 20_000
IMAGE = "sensor_msgs/msg/Image"


def open_recording() -> Target:
    """Recordings of the three formats: the first byte says which, the rest is the file."""
    holder = tempfile.TemporaryDirectory(prefix="fuzz-recording-")
    folder = Path(holder.name)
    forget = _remember_definitions()
    seeds = [bytes([place]) + _recording(folder / kind, kind) for place, kind in enumerate(FORMATS)]

    def run(data: bytes) -> None:
        path = folder / f"input{SUFFIXES[data[0] % len(SUFFIXES)] if data else '.mcap'}"
        path.write_bytes(data[1:])
        with refusing(*READ_CODES):
            source = BagSource(path)
            events = sum(1 for _ in source.events())
            assert events <= EVENTS_MAX_COUNT, "so small a file says so much"
            assert source.focal_px is None or source.focal_px > 0
            assert source.empty_frames()

    def close() -> None:
        forget()
        holder.cleanup()

    return Target("recording", seeds, run, None, 32 * 1024, close)


def _remember_definitions() -> Callable[[], None]:
    """The library's grammar takes most of the time, for the same few texts again and again. Returns what undoes it."""
    remembered = functools.lru_cache(maxsize=1024)(get_types_from_msg)

    def put(function: object) -> None:
        message_types.get_types_from_msg = function  # type: ignore[assignment, attr-defined]

    put(lambda text, name: dict(remembered(text, name)))
    return lambda: put(get_types_from_msg)


def _recording(path: Path, kind: str) -> bytes:
    pixels = np.full((4, 6), 1500, np.uint16)
    tag = {"header": stamp(START_MS), "epc": "E200", "distance": 1.5, "distance_sigma": 0.1, "antenna_facing": "front"}
    topics = [
        Topic(DEPTH_TOPIC, IMAGE, [(at, image(pixels, at_ms=START_MS + at)) for at in (0, 33)]),
        Topic(EMPTY_TOPIC, IMAGE, [(0, image(pixels))]),
        Topic(SIGHTING_TOPIC, SIGHTING_TYPE, [(10, tag)]),
    ]
    return storage_file(record(path, kind, topics)).read_bytes()
