"""ROS 1 .bag and rosbag2 (SQLite, MCAP) recordings.

Intact ones are read by index, in time order; truncated ones from the front, ending with BAG_DAMAGED.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_typestore

from clients.robot.sources.messages.message_types import (
    DEFINITIONS_MAX_COUNT,
    DEFINITIONS_MAX_WORK,
    WORD_MAX_CHARS,
    DefinitionTooLongError,
    Message,
    MessageTypes,
    count_work,
    parse_definition,
    types_with,
)
from clients.robot.sources.recordings.bounded_chunks import bound_chunks
from clients.robot.sources.recordings.bounded_readers import BoundedRos1Reader, bound_readers
from clients.robot.sources.recordings.budget import RecordingBudget, budget_for
from clients.robot.sources.recordings.database import bound_databases
from clients.robot.sources.recordings.metadata import ForeignMetadataError
from clients.robot.sources.recordings.salvage import BrokenOffError, Channel, SalvagedMessage, scan_file
from consensus.errors import BlockRobotError

bound_chunks()
bound_databases()
bound_readers()

STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_SUFFIXES = (".bag", ".bag.active")
"""The second is what a ROS 1 recorder leaves that was killed."""

CHANNELS_MAX_COUNT = 4_096
"""Of a recording that is read without an index: each publisher of a topic has one in ROS 1."""

SUFFIXES = (*ROS1_SUFFIXES, *STORAGE_SUFFIXES)


@dataclass(slots=True)
class TopicFigures:
    """A recorded topic: type, number of messages, average messages per second."""

    name: str
    type: str
    count: int = 0
    rate_hz: float = 0.0
    types: set[str] = field(default_factory=set)


def explain_undefined(figures: TopicFigures, who: str) -> str:
    return (
        f"{figures.name} carries {figures.type}, which {who}. If it holds tag readings, put the type's text into the "
        "topics file under [definitions], and name topic and fields under [[tags]]."
    )


class Recording:
    """An opened recording; `broken` describes damage, `definitions` adds missing types. Raises BAG_DAMAGED,
    RECORDING_TOO_LARGE, TOPICS_INVALID.
    """

    def __init__(self, path: Path, definitions: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.broken = ""
        self.topics: dict[str, TopicFigures] = {}
        self._ros1 = path.name.endswith(ROS1_SUFFIXES)
        self._known = types_with(definitions or {})
        self.types = MessageTypes(self._known, ros1=self._ros1)
        self._salvage: list[Path] = []
        _require_regular(path)
        self._samples_budget = self._budget()
        try:
            with self._budget().current():
                self._look_by_index()
        except BlockRobotError as error:
            if error.code == "RECORDING_TOO_LARGE":
                raise
            self._look_through(error)
        except Exception as error:  # noqa: BLE001 - a damaged file fails in many ways; what is before the break is tried
            self._look_through(error)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages in time order. Raises BAG_DAMAGED at the break, RECORDING_TOO_LARGE."""
        yield from self._budget().over(self._read(topics))

    def _read(self, topics: Collection[str]) -> Generator[Message, None, None]:
        if self._salvage:
            yield from self._salvaged(set(topics))
            return
        try:
            with _reader(self.path) as reader:
                chosen = [connection for connection in reader.connections if connection.topic in topics]
                if not chosen:
                    return
                for connection, at_ns, data in reader.messages(chosen):
                    _require_kinds((at_ns, int))
                    yield Message(connection.topic, connection.msgtype, at_ns, data)
        except Exception as error:  # a truncated or flipped chunk fails in many ways
            if isinstance(error, BlockRobotError) and error.code == "RECORDING_TOO_LARGE":
                raise
            raise self._damaged() from error

    def types_of(self, type_name: str) -> MessageTypes:  # noqa: ARG002 - a recording has one set for all
        return self.types

    def explain_unknown(self, topic: str) -> str:
        return explain_undefined(self.topics[topic], "the recording does not define")

    def samples(self, topic: str, most: int = 1) -> list[Any]:
        """Raises BAG_DAMAGED."""
        found: list[Any] = []
        if self._samples_budget.is_spent:
            return found
        with suppress(BlockRobotError):
            for message in self._samples_budget.again().over(self._read([topic])):
                with suppress(BlockRobotError):
                    found.append(self.types.decode(message))
                if len(found) == most:
                    break
        return found

    def _look_by_index(self) -> None:
        with _reader(self.path) as reader:
            seconds = reader.duration / 1e9
            for connection in reader.connections:
                _require_kinds((connection.topic, str), (connection.msgtype, str), (connection.msgcount, int))
                self._note(connection.topic, connection.msgtype, connection.msgcount)
            self._learn([(connection.msgtype, connection.msgdef) for connection in reader.connections])
        for figures in self.topics.values():
            figures.rate_hz = round(figures.count / seconds, 2) if seconds > 0 else 0.0

    def _look_through(self, why: Exception) -> None:
        self.topics.clear()
        self._salvage = _storage_files(self.path)
        channels: dict[tuple[Path, int], str] = {}
        definitions: dict[str, MessageDefinition] = {}
        first_ns, last_ns = None, 0
        try:
            for path, item in self._budget().over(self._scan()):
                if isinstance(item, Channel):
                    if len(definitions) < DEFINITIONS_MAX_COUNT:
                        definitions[item.msgtype] = item.definition
                    channels[path, item.number] = item.topic
                    self._note(item.topic, item.msgtype, 0)
                elif (topic := channels.get((path, item.channel))) is not None:
                    self.topics[topic].count += 1
                    first_ns = item.at_ns if first_ns is None else first_ns
                    last_ns = item.at_ns
        except BrokenOffError as error:
            self.broken = str(error)
        if first_ns is None:
            self.broken = str(why) if isinstance(why, ForeignMetadataError) else self.broken
            raise self._damaged() from why
        self._learn(list(definitions.items()))
        seconds = max(0, last_ns - first_ns) / 1e9
        for figures in self.topics.values():
            figures.rate_hz = round(figures.count / seconds, 2) if seconds > 0 else 0.0

    def _budget(self) -> RecordingBudget:
        try:
            return budget_for(self.path)
        except OSError:
            return RecordingBudget(0)  # reading it tells what is wrong

    def _scan(self) -> Generator[tuple[Path, Channel | SalvagedMessage], None, None]:
        channels: set[tuple[Path, int, str, str]] = set()
        for path in self._salvage:
            for item in scan_file(path):
                if isinstance(item, Channel):
                    channels.add((path, item.number, item.topic, item.msgtype))
                    if len(channels) > CHANNELS_MAX_COUNT:
                        raise BrokenOffError("It has more topics than anybody records.")
                yield path, item

    def _salvaged(self, topics: set[str]) -> Iterator[Message]:
        channels: dict[tuple[Path, int], tuple[str, str]] = {}
        try:
            for path, item in self._scan():
                if isinstance(item, Channel):
                    channels[path, item.number] = item.topic, item.msgtype
                    continue
                topic, msgtype = channels.get((path, item.channel), ("", ""))
                if topic in topics:
                    yield Message(topic, msgtype, item.at_ns, item.data)
        except BrokenOffError as error:
            raise self._damaged() from error

    def _note(self, topic: str, kind: str, count: int) -> None:
        figures = self.topics.setdefault(topic, TopicFigures(topic, kind))
        figures.types.add(kind)
        figures.count += count

    def _learn(self, definitions: list[tuple[str, MessageDefinition]]) -> None:
        """Add the recording's types, overriding built-in ones (ROS 1 differs)."""
        store = get_typestore(Stores.EMPTY)
        work_left = DEFINITIONS_MAX_WORK
        defined = [
            (name, what) for name, what in dict(definitions).items() if what.format is not MessageDefinitionFormat.NONE
        ]
        for place, (name, definition) in enumerate(defined):
            try:
                work_left -= count_work(definition)
                if work_left < 0 or place >= DEFINITIONS_MAX_COUNT:
                    raise DefinitionTooLongError
                store.register(parse_definition(name, definition))
            except DefinitionTooLongError:
                shown = name[:WORD_MAX_CHARS]
                self.broken = self.broken or f"Its definition of {shown} is longer than anybody writes one."
            except Exception:  # noqa: BLE001 - a spoilt definition; its topic is then one of an unknown type
                self.broken = self.broken or f"Its definition of {name[:WORD_MAX_CHARS]} is damaged."
        if any(figures.type not in store.fielddefs for figures in self.topics.values()):
            store.register({name: what for name, what in self._known.fielddefs.items() if name not in store.fielddefs})
        self.types = MessageTypes(store, ros1=self._ros1)

    def _damaged(self) -> BlockRobotError:
        detail = self.broken or "It is damaged or not a recording."
        return BlockRobotError("BAG_DAMAGED", f"The recording {self.path.name} cannot be read whole. {detail}")


def _require_kinds(*pairs: tuple[Any, type]) -> None:
    """Raise BrokenOffError on a wrong type: SQLite columns are untyped."""
    if any(type(value) is not kind for value, kind in pairs):
        raise BrokenOffError("A row holds what no recorder writes.")


def _reader(path: Path) -> BoundedRos1Reader | Ros2Reader:
    return BoundedRos1Reader(path) if path.suffix == ".bag" else Ros2Reader(path)


def _require_regular(path: Path) -> None:
    """Raise BAG_DAMAGED unless regular: reading other files may never end."""
    try:
        for file in path.iterdir() if path.is_dir() else [path]:
            if file.exists() and not (file.is_file() or (path.is_dir() and file.is_dir())):
                raise BlockRobotError("BAG_DAMAGED", f"{file.name} is no regular file.")
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror}.") from None


def _storage_files(path: Path) -> list[Path]:
    """Raises BAG_DAMAGED."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES and file.is_file()]
        found = sorted(files, key=lambda file: (len(file.name), file.name))  # ..._9 before ..._10
    else:
        found = [path] if path.is_file() and path.name.endswith(SUFFIXES) else []
    if not path.exists():
        raise BlockRobotError("FILE_UNUSABLE", f"There is no recording at {path}.")
    if not found:
        kinds = "a ROS 1 .bag, a rosbag2 folder, or one .mcap or .db3 file"
        raise BlockRobotError("BAG_DAMAGED", f"{path.name} is no recording that can be read; one is {kinds}.")
    return found
