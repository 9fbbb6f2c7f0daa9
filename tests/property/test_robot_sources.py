"""Random and spoilt messages never make the robot's decoders raise anything but a refusal."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.robot.sensing.message_names import IMAGE_TYPE, SIGHTING_TYPE
from clients.robot.sensing.sensor_events import Frame, RefusedMessage, Sighting
from clients.robot.sources.messages.message_types import Message
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.recordings.recording import Recording
from clients.robot.synthetic.bag_messages import MessageCodec
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import START_MS, Topic, image, record, stamp, storage_file

DEPTH_TOPIC, TAG_TOPIC = "/camera/depth/image_raw", "/rfid/sightings"


@cache
def source() -> BagSource:
    """A source whose own messages are of no interest: spoilt ones are handed to its decoders."""
    reading = {"epc": "E1", "first_seen": stamp(START_MS)["stamp"], "last_seen": stamp(START_MS)["stamp"]}
    topics = [
        Topic(DEPTH_TOPIC, IMAGE_TYPE, [(0, image(np.full((6, 8), 900, np.uint16)))]),
        Topic(TAG_TOPIC, SIGHTING_TYPE, [(1, reading)]),
    ]
    with TemporaryDirectory() as folder:
        return BagSource(record(Path(folder) / "bag", "mcap", topics))


@cache
def valid() -> dict[str, bytes]:
    codec = MessageCodec()
    sighting = Sighting(START_MS, START_MS + 5, "E2000017", 1, distance_m=2.0, sigma_m=0.3)
    return {
        DEPTH_TOPIC: bytes(codec.encode_image(np.full((6, 8), 900, np.uint16), START_MS)),
        TAG_TOPIC: bytes(codec.encode_sighting(sighting, START_MS)),
    }


def outcome(topic: str, data: bytes) -> list[Frame | Sighting | RefusedMessage]:
    kind = IMAGE_TYPE if topic == DEPTH_TOPIC else SIGHTING_TYPE
    found = source().events_of(Message(topic, kind, START_MS * 1_000_000, data))
    assert all(isinstance(event, Frame | Sighting | RefusedMessage) for event in found)
    return found  # type: ignore[return-value]


@pytest.fixture(scope="module", autouse=True)
def _made_before_time_is_measured() -> None:
    source()
    valid()


topics = st.sampled_from([DEPTH_TOPIC, TAG_TOPIC])


@given(topics, st.binary(max_size=400))
def test_random_bytes_are_refused_or_make_a_whole_event(topic: str, data: bytes) -> None:
    outcome(topic, b"\x00\x01\x00\x00" + data)
    outcome(topic, data)


@given(topics, st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 7)), min_size=1, max_size=6))
def test_flipped_bits_are_refused_or_make_a_whole_event(topic: str, flips: list[tuple[int, int]]) -> None:
    data = bytearray(valid()[topic])
    for place, bit in flips:
        data[place % len(data)] ^= 1 << bit
    for event in outcome(topic, bytes(data)):
        if isinstance(event, Frame):
            assert event.depth.dtype == np.uint16
            assert event.depth.size > 0
        if isinstance(event, Sighting):
            assert 0 < len(event.uid) <= 64
            assert 0 <= event.last_seen_ms - event.first_seen_ms <= 60_000
            assert event.distance_m is None or (event.sigma_m is not None and event.distance_m > 0 < event.sigma_m)


@given(topics, st.integers(0, 200))
def test_a_message_that_ends_early_is_refused(topic: str, kept: int) -> None:
    data = valid()[topic]
    assert [type(event) for event in outcome(topic, data[: min(kept, len(data) - 9)])] == [RefusedMessage]


@given(
    st.sampled_from(["cut", "flip", "zero"]),
    st.integers(0, 10**7),
    st.integers(1, 255),
    st.sampled_from([".mcap", ".bag", ".db3"]),
)
def test_a_spoilt_file_ends_in_a_code_and_never_in_another_exception(
    how: str, place: int, change: int, suffix: str
) -> None:
    data = bytearray(file_of(suffix))
    at = place % len(data)
    if how == "cut":
        del data[at:]
    elif how == "flip":
        data[at] ^= change
    else:
        data[at : at + change] = bytes(len(data[at : at + change]))
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"spoilt{suffix}"
        path.write_bytes(bytes(data))
        assert codes_of(path) <= {"BAG_DAMAGED", "FRAME_INVALID"}


def codes_of(path: Path) -> set[str]:
    """Read a recording to its end and return the codes of all refusals on the way."""
    codes = set()
    try:
        opened = Recording(path)
        for message in opened.messages(list(opened.topics)):
            try:
                opened.types.decode(message)
            except BlockRobotError as error:
                codes.add(error.code)
    except BlockRobotError as error:
        codes.add(error.code)
    return codes


@cache
def file_of(suffix: str) -> bytes:
    rng = np.random.default_rng(1)
    images = [(i, image(rng.integers(1, 9_000, (12, 16), np.uint16), at_ms=START_MS + i)) for i in range(8)]
    kind = {".mcap": "mcap", ".bag": "ros1", ".db3": "sqlite3"}[suffix]
    with TemporaryDirectory() as folder:
        path = record(
            Path(folder) / "bag",
            kind,
            [Topic("/a", IMAGE_TYPE, images), Topic("/b", "std_msgs/msg/String", [(3, {"data": "E1"})])],
        )
        return storage_file(path).read_bytes()
