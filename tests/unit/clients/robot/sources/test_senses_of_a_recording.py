"""Colour, estimates, sound and the camera's lens as a recording tells them, and what is refused of them."""

from __future__ import annotations

import wave
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clients.robot.sensing.message_names import DEPTH_TOPIC
from clients.robot.sensing.sensor_events import AudioClip, ColourFrame, Label, RefusedMessage, SourceEvent
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.sources.recordings.bag_source import BagSource
from tests.unit.clients.robot.sources.recordings import FORMATS, START_MS, Topic, image, record, stamp

TYPES = {
    "ward_msgs/msg/Mood": "std_msgs/Header header\nstring mood\nfloat32 sure",
    "ward_msgs/msg/Sound": "std_msgs/Header header\nuint8[] data",
}
TAGS = "[[tags]]\ntopic = '/tags'\nepc = 'data'\n"
MOOD = TAGS + "[labels]\ntopic = '/mood'\ntext = 'mood'\nconfidence = 'sure'\n"
SOUND = TAGS + "[audio]\ntopic = '/sound'\nrate_hz = 8000\nchannels = 2\n"
DEPTH = np.full((4, 6), 1500, np.uint16)


def read(folder: Path, text: str, *topics: Topic, kind: str = "mcap", types: Any = None) -> list[SourceEvent]:
    folder.mkdir(exist_ok=True)
    always = [
        Topic(DEPTH_TOPIC, "sensor_msgs/msg/Image", [(0, image(DEPTH))]),
        Topic("/tags", "std_msgs/msg/String", [(0, {"data": "E1"})]),
    ]
    events = BagSource(
        record(folder / "bag", kind, [*always, *topics], types or TYPES), topics=parse_topics(text)
    ).events()
    return [event for event in events if isinstance(event, ColourFrame | Label | AudioClip | RefusedMessage)]


def mood(**fields: Any) -> Topic:
    return Topic(
        "/mood", "ward_msgs/msg/Mood", [(9, {"header": stamp(START_MS + 7), "mood": "calm", "sure": 0.5, **fields})]
    )


def sound(data: bytes) -> Topic:
    return Topic(
        "/sound", "ward_msgs/msg/Sound", [(9, {"header": stamp(START_MS), "data": np.frombuffer(data, np.uint8)})]
    )


def wav(frames: int, *, width: int = 2) -> bytes:
    packed = BytesIO()
    with wave.open(packed, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(width)
        file.setframerate(16_000)
        file.writeframes(bytes(width * frames))
    return packed.getvalue()


@pytest.mark.parametrize("kind", FORMATS)
def test_an_estimate_has_its_stamp_and_its_confidence(tmp_path: Path, kind: str) -> None:
    assert read(tmp_path, MOOD, mood(), kind=kind) == [Label(START_MS + 7, 0, "calm", 0.5, START_MS + 9)]


@pytest.mark.parametrize("fields", [{"mood": " "}, {"mood": "x" * 257}, {"sure": 1.5}, {"sure": float("nan")}])
def test_an_estimate_that_makes_no_sense_is_refused(tmp_path: Path, fields: dict[str, Any]) -> None:
    assert read(tmp_path, MOOD, mood(**fields)) == [RefusedMessage(START_MS + 9, "label", "field")]


def test_samples_are_what_the_file_says_and_a_wav_file_is_what_it_says_itself(tmp_path: Path) -> None:
    (clip,) = read(tmp_path / "samples", SOUND, sound(bytes(3_200)))
    assert isinstance(clip, AudioClip)
    assert (clip.rate_hz, clip.channels, clip.ends_ms - clip.at_ms) == (8_000, 2, 100)
    (told,) = read(tmp_path / "wav", SOUND, sound(wav(1_600)))
    assert isinstance(told, AudioClip)
    assert (told.rate_hz, told.channels, told.ends_ms - told.at_ms) == (16_000, 1, 100)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "size"),
        (bytes(3_201), "size"),
        (bytes(32_000 * 11), "size"),
        (wav(10, width=1), "encoding"),
        (wav(10)[:20], "undecodable"),
        (b"RIFF" + bytes(100), "undecodable"),
    ],
)
def test_sound_that_is_not_whole_is_refused(tmp_path: Path, data: bytes, reason: str) -> None:
    assert read(tmp_path, SOUND, sound(data)) == [RefusedMessage(START_MS + 9, "audio", reason)]


@pytest.mark.parametrize(
    ("type_name", "value"),
    [
        ("string", "sound"),
        ("float32", 0.5),
        ("int32", 16_000),
        ("uint32", 2**32 - 1),
        ("bool", True),
        ("float32[]", np.zeros(4, np.float32)),
        ("string[]", ["a", "b"]),
    ],
)
def test_a_field_that_holds_no_sound_is_refused_and_nothing_is_made_of_it(
    tmp_path: Path, type_name: str, value: Any
) -> None:
    types = {"ward_msgs/msg/Odd": f"std_msgs/Header header\n{type_name} data"}
    odd = Topic("/sound", "ward_msgs/msg/Odd", [(9, {"header": stamp(START_MS), "data": value})])
    assert read(tmp_path, SOUND, odd, types=types) == [RefusedMessage(START_MS + 9, "audio", "field")]


def test_colour_is_registered_only_if_the_user_says_so(tmp_path: Path) -> None:
    pixels = np.zeros((4, 6, 3), np.uint8)
    colour = Topic("/rgb", "sensor_msgs/msg/Image", [(9, image(pixels, "bgr8")), (19, image(DEPTH))])
    for registered in (False, True):
        text = TAGS + f"[rgb]\ntopic = '/rgb'\nregistered = {str(registered).lower()}\n"
        frame, refused = read(tmp_path / str(registered), text, colour)
        assert isinstance(frame, ColourFrame)
        assert (frame.registered, frame.sequence, frame.pixels.shape) == (registered, 0, (4, 6, 3))
        assert refused == RefusedMessage(START_MS + 19, "rgb", "encoding")


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(("told", "focal"), [(570.3, 570.3), (0.0, None), (float("nan"), None), (1e9, None)])
def test_the_focal_length_is_taken_from_the_camera_info_beside_the_depth(
    tmp_path: Path, kind: str, told: float, focal: float | None
) -> None:
    matrix = np.array([told, 0, 3, 0, told, 2, 0, 0, 1.0])
    name = "K" if kind == "ros1" else "k"
    rest: Mapping[str, Any] = {letter: np.zeros(size) for letter, size in (("d", 0), ("r", 9), ("p", 12))}
    fields = {key.upper() if kind == "ros1" else key: value for key, value in rest.items()} | {name: matrix}
    topics = [
        Topic(DEPTH_TOPIC, "sensor_msgs/msg/Image", [(0, image(DEPTH))]),
        Topic(DEPTH_TOPIC.rpartition("/")[0] + "/camera_info", "sensor_msgs/msg/CameraInfo", [(0, fields)]),
        Topic("/tags", "std_msgs/msg/String", [(0, {"data": "E1"})]),
    ]
    path = record(tmp_path / "bag", kind, topics, TYPES)
    assert BagSource(path, topics=parse_topics(TAGS)).focal_px == focal
    assert BagSource(path, topics=parse_topics("[depth]\nfocal_px = 400\n" + TAGS)).focal_px == 400
