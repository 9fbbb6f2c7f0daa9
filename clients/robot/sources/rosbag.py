"""A recording as a source: frames, tag sightings and other senses, in the order in which they were recorded.

A message that cannot be used becomes a `Refused`, and the stream goes on; a recording that breaks off ends in
BAG_DAMAGED after everything before the break. Must never write anything.
"""

from __future__ import annotations

import struct
import wave
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from clients.robot.events import AudioClip, ColourFrame, Depth, Frame, Label, Refused, SourceEvent
from clients.robot.sources.field_map import header_ms, read_path
from clients.robot.sources.images import COMPRESSED_TYPE, IMAGE_TYPE, decode_colour, decode_depth, refuse
from clients.robot.sources.listing import describe
from clients.robot.sources.recording import Message, Recording
from clients.robot.sources.source import NS_PER_MS, Clock, happened_ms, play_events
from clients.robot.sources.topics import AudioTopic, LabelTopic, TagTopic, Topics
from consensus.errors import BlockRobotError

EMPTY_FRAMES_READ_MAX_COUNT = 300
EMPTY_FRAMES_MAX_COUNT = 64
EMPTY_FRAMES_MAX_BYTES = 256 * 1024 * 1024
LABEL_MAX_CHARS = 256
AUDIO_MAX_MS = 10_000
AUDIO_MAX_BYTES = 900_000
FOCAL_MIN_PX, FOCAL_MAX_PX = 20.0, 10_000.0


@dataclass(frozen=True, slots=True)
class EmptyScene:
    """Where the frames without people are, if not on the topic that is meant for them.

    Another recording (its depth topic), or a stretch of this one in seconds from its first frame.
    """

    recording: Path | None = None
    seconds: tuple[float, float] | None = None


class BagSource:
    """One recording. `shift_ms` is added to every time in it, so that an old recording plays in the present.

    Raises BAG_DAMAGED when nothing in it can be read, BAG_TOPIC_MISSING when it has no depth or no sightings.
    """

    def __init__(
        self, path: Path, *, topics: Topics | None = None, empty: EmptyScene | None = None, shift_ms: int = 0
    ) -> None:
        self.path = path
        self.shift_ms = shift_ms
        self._topics = topics or Topics()
        self._empty = empty or EmptyScene()
        self._recording = Recording(path, self._topics.definitions)
        self._check_topics()
        self._wanted = self._topics.wanted
        self._tags = {tags.topic: tags for tags in self._topics.tags}
        self._sequences = dict.fromkeys(_NAMES, 0)
        figures = self._recording.topics
        self.frame_count = figures[self._topics.depth].count
        self.sighting_count = sum(figures[tags.topic].count for tags in self._topics.tags)
        self.empty_frame_count = figures[self._topics.empty].count if self._topics.empty in figures else 0

    @property
    def broken(self) -> str:
        """What is wrong with the recording as a whole; empty if nothing is."""
        return self._recording.broken

    @property
    def start_ms(self) -> int:
        """When the first usable event was recorded, `shift_ms` included. Raises BAG_DAMAGED if there is none."""
        for event in self.events():
            if not isinstance(event, Refused):
                return happened_ms(event)
        raise BlockRobotError("BAG_DAMAGED", "The recording holds no frame that can be used.")

    @property
    def focal_px(self) -> float | None:
        """The focal length that the user names, or the one of the CameraInfo beside the depth topic."""
        if self._topics.focal_px is not None:
            return self._topics.focal_px
        beside = self._topics.depth.rpartition("/")[0] + "/camera_info"
        if beside not in self._recording.topics:
            return None
        matrix = getattr(self._recording.first(beside), "k", getattr(self._recording.first(beside), "K", (0.0,)))
        told = float(matrix[0])
        return told if FOCAL_MIN_PX <= told <= FOCAL_MAX_PX else None

    def shift_to(self, start_ms: int) -> None:
        """Move the timeline so that the first usable event happens at `start_ms`."""
        self.shift_ms += start_ms - self.start_ms

    def empty_frames(self) -> list[Depth]:
        """Return the recorded frames of the empty scene; raises EMPTY_SCENE_MISSING if there are none."""
        if self._empty.recording is not None:
            found = self._empty_elsewhere(self._empty.recording)
        elif self._empty.seconds is not None:
            found = self._depths(self._recording, self._topics.depth, self._empty.seconds)
        else:
            found = self._depths(self._recording, self._topics.empty, None)
        if found:
            return found
        if self.broken:
            raise BlockRobotError("BAG_DAMAGED", f"{self.path.name} breaks off before its empty frames.")
        raise BlockRobotError(
            "EMPTY_SCENE_MISSING",
            "There are no usable frames of the empty scene, and without them nobody can be told from the background. "
            + describe(self._recording),
        )

    def events(self) -> Iterator[SourceEvent]:
        """Yield frames (numbered from 0), sightings and senses as recorded, and a `Refused` for each bad message."""
        self._sequences = dict.fromkeys(_NAMES, 0)
        for message in self._recording.messages(self._wanted):
            yield from self.events_of(message)

    def events_of(self, message: Message) -> list[SourceEvent]:
        """Return what one message says: its events, or a `Refused`."""
        kind = self._wanted[message.topic]
        try:
            return list(self._read(kind, message))
        except BlockRobotError as error:
            if error.code != "FRAME_INVALID":
                raise
            reason = str(error.context.get("reason", "size"))
            return [Refused(message.at_ns // NS_PER_MS + self.shift_ms, _NAMES[kind], reason)]

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Yield the same events, each no earlier than `clock` says it was recorded. Shift the timeline first."""
        return play_events(self.events(), clock)

    def _read(self, kind: str, message: Message) -> Iterator[SourceEvent]:
        content = self._recording.decode(message)
        recorded_ms = message.at_ns // NS_PER_MS
        stamped = header_ms(content) if self._topics.clock == "stamp" else None
        at_ms = recorded_ms if stamped is None else stamped
        received_ms = recorded_ms + self.shift_ms
        if kind == "tags":
            yield from self._sightings(self._tags[message.topic], content, at_ms, received_ms)
            return
        if kind == "depth":
            event: SourceEvent = Frame(at_ms + self.shift_ms, self._sequences[kind], decode_depth(content), received_ms)
        else:
            event = self._sense(kind, content, at_ms + self.shift_ms, received_ms)
        self._sequences[kind] += 1
        yield event

    def _sense(self, kind: str, content: Any, at_ms: int, received_ms: int) -> SourceEvent:
        sequence = self._sequences[kind]
        if kind == "rgb":
            return ColourFrame(at_ms, sequence, decode_colour(content), self._topics.rgb_registered, received_ms)
        if kind == "labels":
            assert self._topics.labels is not None
            return _label(self._topics.labels, content, at_ms, sequence, received_ms)
        assert self._topics.audio is not None
        return _audio(self._topics.audio, content, at_ms, sequence, received_ms)

    def _sightings(self, tags: TagTopic, content: Any, at_ms: int, received_ms: int) -> Iterator[SourceEvent]:
        sightings, reasons = tags.map.read(content, at_ms, self.shift_ms, received_ms)
        yield from sightings
        for reason in reasons:
            yield Refused(received_ms, "sighting", reason)

    def _depths(self, recording: Recording, topic: str, seconds: tuple[float, float] | None) -> list[Depth]:
        """Return the usable frames of a topic that are of the first one's size, within `seconds` if given.

        Of many no more than so many frames and bytes, spread evenly over those that were read.
        """
        frames: list[Depth] = []
        usable, step = 0, 1
        first_ns: int | None = None
        try:
            for message in recording.messages([topic]):
                first_ns = message.at_ns if first_ns is None else first_ns
                at_s = (message.at_ns - first_ns) / 1e9
                if seconds is not None and not seconds[0] <= at_s <= seconds[1]:
                    if at_s > seconds[1]:
                        break
                    continue
                try:
                    depth = decode_depth(recording.decode(message))
                except BlockRobotError:
                    continue
                if frames and depth.shape != frames[0].shape:
                    continue
                if usable % step == 0:
                    frames.append(depth)
                if len(frames) > max(1, min(EMPTY_FRAMES_MAX_COUNT, EMPTY_FRAMES_MAX_BYTES // depth.nbytes)):
                    frames, step = frames[::2], 2 * step
                usable += 1
                if usable == EMPTY_FRAMES_READ_MAX_COUNT:
                    break
        except BlockRobotError:
            if not frames:  # what stands before the break is as good as ever
                raise
        return frames

    def _empty_elsewhere(self, path: Path) -> list[Depth]:
        other = Recording(path, self._topics.definitions)
        for topic in (self._topics.empty, self._topics.depth):
            if topic in other.topics:
                return self._depths(other, topic, self._empty.seconds)
        raise BlockRobotError(
            "EMPTY_SCENE_MISSING", f"{path.name} has no topic {self._topics.depth}. " + describe(other)
        )

    def _check_topics(self) -> None:
        found = self._recording.topics
        for topic, kind in self._topics.wanted.items():
            if topic not in found:
                if self.broken:
                    raise BlockRobotError("BAG_DAMAGED", f"{self.path.name} breaks off before {topic}. {self.broken}")
                raise _missing(f"The recording has no topic {topic}.", self._recording)
            types = found[topic].types
            if len(types) > 1:
                raise _missing(f"Topic {topic} carries several types: {', '.join(sorted(types))}.", self._recording)
            if kind in ("depth", "rgb") and not types <= {IMAGE_TYPE, COMPRESSED_TYPE}:
                raise _missing(f"Topic {topic} carries {found[topic].type}, which is no image.", self._recording)
            if not self._recording.knows(found[topic].type):
                raise BlockRobotError(
                    "TOPICS_INVALID",
                    f"The recording does not define {found[topic].type}: put its text under [definitions].",
                )
        for tags in self._topics.tags:
            if tags.type and found[tags.topic].type != tags.type:
                raise _missing(
                    f"Topic {tags.topic} carries {found[tags.topic].type}, not {tags.type}.", self._recording
                )


_NAMES = {"depth": "frame", "tags": "sighting", "rgb": "rgb", "labels": "label", "audio": "audio"}


def _label(topic: LabelTopic, content: Any, at_ms: int, sequence: int, received_ms: int) -> Label:
    text = read_path(content, topic.text)
    if not isinstance(text, str) or not 0 < len(text.strip()) <= LABEL_MAX_CHARS:
        raise refuse("field", "A label is no text, empty, or too long.")
    told = read_path(content, topic.confidence) if topic.confidence else None
    if told is not None and not (isinstance(told, float | int) and 0 <= float(told) <= 1):
        raise refuse("field", "A label's confidence is no share from 0 to 1.")
    return Label(at_ms, sequence, text.strip(), None if told is None else float(told), received_ms)


def _audio(topic: AudioTopic, content: Any, at_ms: int, sequence: int, received_ms: int) -> AudioClip:
    """Return samples as they stand, or those of a WAV file."""
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
    """Return bytes, an array of octets or 16-bit samples, or a list of octets, as they stand in the message."""
    if isinstance(samples, bytes | bytearray):
        found = bytes(samples)
    elif isinstance(samples, np.ndarray) and samples.dtype.kind in "iu" and samples.dtype.itemsize <= 2:
        found = samples.tobytes()
    elif isinstance(samples, list) and all(type(one) is int and 0 <= one <= 255 for one in samples):
        found = bytes(samples)
    else:
        raise refuse("field", "The sound is no bytes and no 16-bit samples.")
    return found


def _missing(sentence: str, recording: Recording) -> BlockRobotError:
    return BlockRobotError("BAG_TOPIC_MISSING", f"{sentence} {describe(recording)}")
