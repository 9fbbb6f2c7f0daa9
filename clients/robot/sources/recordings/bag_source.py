"""A recording as a source: frames, tag sightings and other senses, in the order in which they were recorded.

A message that cannot be used becomes a `Refused`, and the stream goes on; a recording that breaks off ends in
BAG_DAMAGED after everything before the break.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

from clients.robot.sensing.sensor_events import Depth, Refused, SourceEvent
from clients.robot.sources.live.live_feed import Message
from clients.robot.sources.messages.decoding import AntennaCounts, MessageReader, info_topic, read_focal_px, wrong_type
from clients.robot.sources.messages.image_decoding import decode_depth, refusing_other_fields
from clients.robot.sources.recordings.empty_frame_choice import EmptyFrames
from clients.robot.sources.recordings.path_checks import missing_field
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import describe
from clients.robot.sources.source import Clock, happened_ms, play_events
from clients.robot.sources.topics import Topics
from consensus.errors import BlockRobotError


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
        self._reader = MessageReader(self._topics)
        figures = self._recording.topics
        self.frame_count = figures[self._topics.depth].count
        self.sighting_count = sum(figures[tags.topic].count for tags in self._topics.tags)
        self.empty_frame_count = figures[self._topics.empty].count if self._topics.empty in figures else 0

    @property
    def topics(self) -> Topics:
        """What is read of which topic."""
        return self._topics

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
        beside = info_topic(self._topics)
        return read_focal_px(self._recording.first(beside)) if beside in self._recording.topics else None

    @property
    def focal_from(self) -> str:
        """Where the focal length is from."""
        return "camera-info" if self._topics.focal_px is None else "topics"

    @property
    def antennas_unnamed(self) -> AntennaCounts:
        """How often antennas were heard that the topics file names neither in front nor in back."""
        return self._reader.antennas_unnamed

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
        self._reader = MessageReader(self._topics)
        for message in self._recording.messages(self._wanted):
            yield from self.events_of(message)

    def events_of(self, message: Message) -> list[SourceEvent]:
        """Return what one message says: its events, or a `Refused`."""
        return self._reader.read(message, self._recording.types, shift_ms=self.shift_ms)

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Yield the same events, each no earlier than `clock` says it was recorded. Shift the timeline first."""
        return play_events(self.events(), clock)

    def _depths(self, recording: Recording, topic: str, seconds: tuple[float, float] | None) -> list[Depth]:
        """Return the usable frames of a topic that are of the first one's size, within `seconds` if given.

        Of many no more than so many frames and bytes, spread evenly over those that were read.
        """
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
