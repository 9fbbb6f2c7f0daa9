"""A recording as a source in recorded order; damage ends with BAG_DAMAGED."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

from clients.robot.sensing.message_names import ODOMETRY_TYPE
from clients.robot.sensing.sensor_events import Depth, RefusedMessage, SourceEvent
from clients.robot.sources.messages.decoding import AntennaCounts, MessageReader, info_topic, read_focal_px, wrong_type
from clients.robot.sources.messages.image_decoding import decode_depth, refusing_other_fields
from clients.robot.sources.messages.message_types import Message
from clients.robot.sources.messages.topics import Topics, missing_field
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import describe
from clients.robot.sources.source import Clock, EmptyFrames, happened_ms, play_events
from consensus.errors import BlockRobotError


@dataclass(frozen=True, slots=True)
class EmptyScene:
    """Frames without people: another recording, or seconds from this one's start."""

    recording: Path | None = None
    seconds: tuple[float, float] | None = None


class BagSource:
    """A recording, times shifted by `shift_ms`. Raises BAG_DAMAGED, BAG_TOPIC_MISSING."""

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
        self._reader = MessageReader(self._topics)
        figures = self._recording.topics
        self.frame_count = figures[self._topics.depth].count
        self.silent_tag_topics = [tags.topic for tags in self._topics.tags if not figures[tags.topic].count]
        odometry = [name for name, topic in figures.items() if topic.type == ODOMETRY_TYPE]
        named = self._topics.odometry
        self.unnamed_odometry = odometry if named is None else []
        self.odometry_rate_hz = None if named is None else figures[named.topic].rate_hz
        self.sighting_count = sum(figures[tags.topic].count for tags in self._topics.tags)
        self.empty_frame_count = figures[self._topics.empty].count if self._topics.empty in figures else 0

    @property
    def topics(self) -> Topics:
        return self._topics

    @property
    def broken(self) -> str:
        return self._recording.broken

    @property
    def start_ms(self) -> int:
        """First usable event's time, shifted. Raises BAG_DAMAGED if none."""
        for event in self.events():
            if not isinstance(event, RefusedMessage):
                return happened_ms(event)
        raise BlockRobotError("BAG_DAMAGED", "The recording holds no frame that can be used.")

    @property
    def focal_px(self) -> float | None:
        if self._topics.focal_px is not None:
            return self._topics.focal_px
        beside = info_topic(self._topics)
        if beside not in self._recording.topics:
            return None
        return next(map(read_focal_px, self._recording.samples(beside)), None)

    @property
    def focal_from(self) -> str:
        return "camera-info" if self._topics.focal_px is None else "topics"

    @property
    def antennas_unnamed(self) -> AntennaCounts:
        """Readings by antennas unnamed in the topics file."""
        return self._reader.antennas_unnamed

    def shift_to(self, start_ms: int) -> None:
        self.shift_ms += start_ms - self.start_ms

    def empty_frames(self) -> list[Depth]:
        """Raises EMPTY_SCENE_MISSING; BAG_TOPIC_MISSING for a recording without a depth image."""
        if not self.frame_count and not self.broken:
            raise _missing(f"The recording has no depth image: 0 messages of {self._topics.depth}.", self._recording)
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
        """Yield frames (from 0), sightings, senses, and `RefusedMessage`."""
        self._reader = MessageReader(self._topics)
        for message in self._recording.messages(self._wanted):
            yield from self.events_of(message)

    def events_of(self, message: Message) -> list[SourceEvent]:
        return self._reader.read(message, self._recording.types, shift_ms=self.shift_ms)

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Shift the timeline first."""
        return play_events(self.events(), clock)

    def _depths(self, recording: Recording, topic: str, seconds: tuple[float, float] | None) -> list[Depth]:
        gathered = EmptyFrames()
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
                    with refusing_other_fields():
                        gathered.add(decode_depth(recording.types.decode(message)))
                except BlockRobotError:
                    continue
                if gathered.is_enough:
                    break
        except BlockRobotError:
            if not gathered.frames:  # what stands before the break is as good as ever
                raise
        return gathered.frames

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
        for topic in self._topics.wanted:
            if topic not in found:
                if self.broken:
                    raise BlockRobotError("BAG_DAMAGED", f"{self.path.name} breaks off before {topic}. {self.broken}")
                raise _missing(f"The recording has no topic {topic}.", self._recording)
            types = found[topic].types
            if len(types) > 1:
                raise _missing(f"Topic {topic} carries several types: {', '.join(sorted(types))}.", self._recording)
            wrong = wrong_type(self._topics, topic, found[topic].type)
            if wrong:
                raise _missing(wrong, self._recording)
            if not self._recording.types.knows(found[topic].type):
                raise BlockRobotError(
                    "TOPICS_INVALID",
                    f"The recording does not define {found[topic].type}: put its text under [definitions].",
                )
            misspelt = missing_field(self._topics, topic, found[topic].type, self._recording.types)
            if misspelt:
                raise BlockRobotError("TOPICS_INVALID", misspelt)


def _missing(sentence: str, recording: Recording) -> BlockRobotError:
    return BlockRobotError("BAG_TOPIC_MISSING", f"{sentence} {describe(recording)}")
