"""Decodes recorded and live messages into events or `RefusedMessage`."""

from __future__ import annotations

import struct
import wave
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np

from clients.robot.sensing.message_names import IMAGE_TYPE
from clients.robot.sensing.sensor_events import (
    NS_PER_MS,
    AudioClip,
    ColourFrame,
    Frame,
    Label,
    RefusedMessage,
    SourceEvent,
)
from clients.robot.sources.messages.field_map import TagMap, header_ms, read_path
from clients.robot.sources.messages.image_decoding import (
    COMPRESSED_TYPE,
    decode_colour,
    decode_depth,
    refuse,
    refusing_other_fields,
)
from clients.robot.sources.messages.message_types import Message, MessageTypes
from clients.robot.sources.messages.odometry_decoding import (
    ODOMETRY_MAX_BYTES,
    ODOMETRY_TYPES,
    TRANSFORM_TYPES,
    read_odometry,
)
from clients.robot.sources.messages.topics import AudioTopic, LabelTopic, Topics
from consensus.errors import BlockRobotError

LABEL_MAX_CHARS = 256
AUDIO_MAX_MS = 10_000
AUDIO_MAX_BYTES = 900_000
FOCAL_MIN_PX, FOCAL_MAX_PX = 20.0, 10_000.0
ANTENNAS_COUNTED_MAX_COUNT = 8
"""So many antennas of a topic are counted that the topics file does not name, by the first characters of their names."""
ANTENNA_NAME_MAX_CHARS = 32
AntennaCounts = dict[str, Counter[str]]
IMAGE_TYPES = frozenset({IMAGE_TYPE, COMPRESSED_TYPE})
KINDS = {
    "depth": "frame",
    "tags": "sighting",
    "rgb": "rgb",
    "labels": "label",
    "audio": "audio",
    "odometry": "odometry",
}
"""What a topic is wanted for, and how events of it are called where they are counted."""


class MessageReader:
    """Reads messages of `topics`; numbers frames and senses from 0."""

    def __init__(self, topics: Topics) -> None:
        self._topics = topics
        self._wanted = topics.wanted
        self._tags = {tags.topic: tags for tags in topics.tags}
        self._sequences = dict.fromkeys(KINDS, 0)
        self.antennas_unnamed: AntennaCounts = {}
        """By topic, how often antennas were heard that the topics file names neither in `front` nor in `back`."""

    def read(self, message: Message, types: MessageTypes, *, shift_ms: int = 0) -> list[SourceEvent]:
        """Return a message's events or a `RefusedMessage`, times shifted by `shift_ms`."""
        kind = self._wanted[message.topic]
        try:
            with refusing_other_fields():
                return list(self._read(kind, message, types, shift_ms))
        except BlockRobotError as error:
            if error.code != "FRAME_INVALID":
                raise
            reason = str(error.context.get("reason", "size"))
            return [RefusedMessage(message.at_ns // NS_PER_MS + shift_ms, KINDS[kind], reason, error.detail)]

    def _read(self, kind: str, message: Message, types: MessageTypes, shift_ms: int) -> Iterator[SourceEvent]:
        self._check_type(message, types)
        if kind == "odometry" and len(message.data) > ODOMETRY_MAX_BYTES:
            raise refuse("size", f"A message of odometry has more than {ODOMETRY_MAX_BYTES} bytes.")
        content = types.decode(message)
        came_ms = message.at_ns // NS_PER_MS
        stamped = header_ms(content) if self._topics.clock == "stamp" else None
        at_ms = came_ms if stamped is None else stamped
        received_ms = came_ms + shift_ms
        if kind == "tags":
            tag_map = self._tags[message.topic].map
            sightings, reasons = tag_map.read(content, at_ms, shift_ms, received_ms, message.topic)
            self._count_antennas(message.topic, tag_map, content)
            yield from sightings
            for reason in reasons:
                yield RefusedMessage(received_ms, KINDS[kind], reason)
            return
        if kind == "odometry":
            assert self._topics.odometry is not None
            for place in read_odometry(self._topics.odometry, content, came_ms, stamped=self._topics.clock == "stamp"):
                yield replace(place, at_ms=place.at_ms + shift_ms, received_at_ms=received_ms)
            return
        if kind == "depth":
            event: SourceEvent = Frame(at_ms + shift_ms, self._sequences[kind], decode_depth(content), received_ms)
        else:
            event = self._sense(kind, content, at_ms + shift_ms, received_ms)
        self._sequences[kind] += 1
        yield event

    def _count_antennas(self, topic: str, tag_map: TagMap, content: Any) -> None:
        for antenna in tag_map.antennas_of(content):
            name = tag_map.unnamed_antenna(antenna)[:ANTENNA_NAME_MAX_CHARS]
            counts = self.antennas_unnamed.setdefault(topic, Counter()) if name else Counter[str]()
            if name and (name in counts or len(counts) < ANTENNAS_COUNTED_MAX_COUNT):
                counts[name] += 1

    def _check_type(self, message: Message, types: MessageTypes) -> None:
        wrong = wrong_type(self._topics, message.topic, message.type)
        if wrong:
            raise refuse("type", wrong)
        if not types.knows(message.type):
            raise refuse("unknown-type", f"Nobody defines {message.type}.")

    def _sense(self, kind: str, content: Any, at_ms: int, received_ms: int) -> SourceEvent:
        sequence = self._sequences[kind]
        if kind == "rgb":
            return ColourFrame(at_ms, sequence, decode_colour(content), self._topics.rgb_registered, received_ms)
        if kind == "labels":
            assert self._topics.labels is not None
            return _label(self._topics.labels, content, at_ms, sequence, received_ms)
        assert self._topics.audio is not None
        return _audio(self._topics.audio, content, at_ms, sequence, received_ms)


def wrong_type(topics: Topics, topic: str, type_name: str) -> str:
    """Empty if it can."""
    if topics.wanted[topic] in ("depth", "rgb") and type_name not in IMAGE_TYPES:
        return f"Topic {topic} carries {type_name}, which is no image."
    if topics.wanted[topic] == "odometry" and type_name not in ODOMETRY_TYPES:
        return f"Topic {topic} carries {type_name}, which is no odometry: {' or '.join(ODOMETRY_TYPES)}."
    odometry = topics.odometry
    is_named = odometry is None or bool(odometry.parent and odometry.child)
    if topics.wanted[topic] == "odometry" and type_name in TRANSFORM_TYPES and not is_named:
        return f"Topic {topic} carries transforms of many frames: name parent and child under [odometry]."
    given = next((tags.type for tags in topics.tags if tags.topic == topic), "")
    return f"Topic {topic} carries {type_name}, not {given}." if given and given != type_name else ""


def info_topic(topics: Topics) -> str:
    """Return the CameraInfo topic beside the depth topic."""
    return topics.depth.rpartition("/")[0] + "/camera_info"


def read_focal_px(info: Any) -> float | None:
    """In px (`k` or `K`); None if unknown."""
    matrix = getattr(info, "k", getattr(info, "K", (0.0,)))
    try:
        given = float(matrix[0])
    except (TypeError, ValueError, LookupError, OverflowError):
        return None
    return given if FOCAL_MIN_PX <= given <= FOCAL_MAX_PX else None


def _label(topic: LabelTopic, content: Any, at_ms: int, sequence: int, received_ms: int) -> Label:
    text = read_path(content, topic.text)
    if not isinstance(text, str) or not 0 < len(text.strip()) <= LABEL_MAX_CHARS:
        raise refuse("field", "A label is no text, empty, or too long.")
    given = read_path(content, topic.confidence) if topic.confidence else None
    if given is not None and not (isinstance(given, float | int) and 0 <= float(given) <= 1):
        raise refuse("field", "A label's confidence is no share from 0 to 1.")
    return Label(at_ms, sequence, text.strip(), None if given is None else float(given), received_ms)


def _audio(topic: AudioTopic, content: Any, at_ms: int, sequence: int, received_ms: int) -> AudioClip:
    data = _sound_bytes(read_path(content, topic.data))
    rate, channels = topic.rate_hz, topic.channels
    if data.startswith(b"RIFF"):
        try:
            with wave.open(BytesIO(data)) as file:
                if file.getsampwidth() != 2:
                    raise refuse("encoding", "The sound is not of 16 bits.")
                rate, channels = file.getframerate(), file.getnchannels()
                data = file.readframes(file.getnframes())
        except (wave.Error, EOFError, struct.error) as error:
            raise refuse("undecodable", "The sound file is damaged.") from error
    if not data or len(data) % (2 * channels) or rate <= 0:
        raise refuse("size", "The sound is empty, or not of whole samples.")
    clip = AudioClip(at_ms, sequence, data, rate, channels, received_ms)
    if clip.ends_ms - clip.at_ms > AUDIO_MAX_MS or len(data) > AUDIO_MAX_BYTES:
        raise refuse("size", "A stretch of sound is longer than ten seconds, or larger than 900 kB.")
    return clip


def _sound_bytes(samples: Any) -> bytes:
    if isinstance(samples, bytes | bytearray):
        found = bytes(samples)
    elif isinstance(samples, np.ndarray) and samples.dtype.kind in "iu" and samples.dtype.itemsize <= 2:
        found = samples.tobytes()
    elif isinstance(samples, list) and all(type(one) is int and 0 <= one <= 255 for one in samples):
        found = bytes(samples)
    else:
        raise refuse("field", "The sound is no bytes and no 16-bit samples.")
    return found
