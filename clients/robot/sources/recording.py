"""One recording of any format: ROS 1 .bag, rosbag2 with SQLite or MCAP, as folder or as file. Must never write anything.

A whole recording is read by its index, in time order. One that was cut off is read from the front to the break, and
says so at the end: `messages` then raises BAG_DAMAGED after the last whole message.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clients.robot.messages import typestore
from clients.robot.sources.salvage import BrokenOffError, Channel, Found, scan_file
from consensus.errors import BlockRobotError

STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_SUFFIXES = (".bag", ".bag.active")
"""The second is what a ROS 1 recorder leaves that was killed."""

SUFFIXES = (*ROS1_SUFFIXES, *STORAGE_SUFFIXES)


@functools.cache
def own_types() -> Typestore:
    """Return the built-in types, made once; never to be changed."""
    return typestore()


@dataclass(slots=True)
class TopicFigures:
    """A topic of a recording: its type, how many messages it has, and how many a second on average."""

    name: str
    type: str
    count: int = 0
    rate_hz: float = 0.0
    types: set[str] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it stands in the recording; `Recording.decode` makes sense of it."""

    topic: str
    type: str
    at_ns: int
    data: bytes


class Recording:
    """A recording that was looked into once: `topics` by name, and `broken`, which says what is wrong with it.

    `definitions` gives the text of types that the recording does not define. Raises BAG_DAMAGED when nothing in it
    can be read, and TOPICS_INVALID when a definition makes no sense.
    """

    def __init__(self, path: Path, definitions: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.broken = ""
        self.topics: dict[str, TopicFigures] = {}
        self._ros1 = path.name.endswith(ROS1_SUFFIXES)
        self._types = _with_definitions(definitions) if definitions else own_types()
        self._salvage: list[Path] = []
        try:
            self._look_by_index()
        except Exception as error:  # noqa: BLE001 - a damaged file fails in many ways; what is before the break is tried
            self._look_through(error)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in time order. Raises BAG_DAMAGED at the break, if there is one."""
        if self._salvage:
            yield from self._salvaged(set(topics))
            return
        try:
            with AnyReader([self.path], default_typestore=own_types()) as reader:
                chosen = [connection for connection in reader.connections if connection.topic in topics]
                if not chosen:
                    return
                for connection, at_ns, data in reader.messages(chosen):
                    yield Message(connection.topic, connection.msgtype, at_ns, data)
        except Exception as error:  # a truncated or flipped chunk fails in many ways
            raise self._damaged() from error

    def decode(self, message: Message) -> Any:
        """Return a message as an object with the fields of its type. Raises FRAME_INVALID, reason `undecodable`."""
        read = self._types.deserialize_ros1 if self._ros1 else self._types.deserialize_cdr
        try:
            return read(message.data, message.type)
        except Exception as error:
            detail = f"A message of {message.topic} is no {message.type}."
            raise BlockRobotError("FRAME_INVALID", detail, reason="undecodable") from error

    def knows(self, type_name: str) -> bool:
        """Tell whether messages of a type can be decoded."""
        return type_name in self._types.types

    def field_names(self, type_name: str) -> list[str]:
        """Return the names of a type's own fields, none if it is not known."""
        if not self.knows(type_name):
            return []
        return [name for name, _ in self._types.fielddefs[type_name][1]]

    def paths(self, type_name: str, deep: int = 3) -> list[str]:
        """Return the paths of a type's plain fields: `epc`, `tags[].epc`. Bytes are one value, a UID perhaps."""
        found = []
        for name, (kind, what) in self._types.fielddefs[type_name][1] if self.knows(type_name) else ():
            each = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            inner = what[0] if each else (kind, what)
            path = name + ("[]" if each and inner != (Nodetype.BASE, ("uint8", 0)) else "")
            if inner[0] is Nodetype.NAME:
                further = self.paths(str(inner[1]), deep - 1) if deep > 1 else []
                found += [f"{path}.{rest}" for rest in further if path.count("[]") + rest.count("[]") < 2]
            else:
                found.append(path)
        return found

    def is_text(self, type_name: str, path: str) -> bool:
        """Tell whether a path of `paths` leads to text, or to a list of texts."""
        part, _, rest = path.partition(".")
        for name, (kind, what) in self._types.fielddefs[type_name][1] if self.knows(type_name) else ():
            if name == part.removesuffix("[]"):
                inner = what[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, what)
                if rest:
                    return inner[0] is Nodetype.NAME and self.is_text(str(inner[1]), rest)
                return bool(inner[0] is Nodetype.BASE and inner[1][0] == "string")
        return False

    def first(self, topic: str) -> Any:
        """Return the first message of a topic that can be decoded, None if there is none."""
        try:
            for message in self.messages([topic]):
                try:
                    return self.decode(message)
                except BlockRobotError:
                    continue
        except BlockRobotError:
            return None
        return None

    def _look_by_index(self) -> None:
        with AnyReader([self.path], default_typestore=own_types()) as reader:
            seconds = reader.duration / 1e9
            for connection in reader.connections:
                self._note(connection.topic, connection.msgtype, connection.msgcount)
            self._learn([(connection.msgtype, connection.msgdef) for connection in _defined(reader.connections)])
        for figures in self.topics.values():
            figures.rate_hz = round(figures.count / seconds, 2) if seconds > 0 else 0.0

    def _look_through(self, why: Exception) -> None:
        """Count what can be read of a recording that has no index, or a damaged one."""
        self.topics.clear()
        self._salvage = _storage_files(self.path)
        channels: dict[tuple[Path, int], Channel] = {}
        first_ns, last_ns = None, 0
        try:
            for path, item in self._scan():
                if isinstance(item, Channel):
                    channels[path, item.number] = item
                    self._note(item.topic, item.msgtype, 0)
                elif (channel := channels.get((path, item.channel))) is not None:
                    self.topics[channel.topic].count += 1
                    first_ns = item.at_ns if first_ns is None else first_ns
                    last_ns = item.at_ns
        except BrokenOffError as error:
            self.broken = str(error)
        if first_ns is None:
            raise self._damaged() from why
        self._learn([(channel.msgtype, channel.definition) for channel in channels.values()])
        seconds = max(0, last_ns - first_ns) / 1e9
        for figures in self.topics.values():
            figures.rate_hz = round(figures.count / seconds, 2) if seconds > 0 else 0.0

    def _scan(self) -> Iterator[tuple[Path, Channel | Found]]:
        for path in self._salvage:
            for item in scan_file(path):
                yield path, item

    def _salvaged(self, topics: set[str]) -> Iterator[Message]:
        channels: dict[tuple[Path, int], Channel] = {}
        try:
            for path, item in self._scan():
                if isinstance(item, Channel):
                    channels[path, item.number] = item
                    continue
                channel = channels.get((path, item.channel))
                if channel is not None and channel.topic in topics:
                    yield Message(channel.topic, channel.msgtype, item.at_ns, item.data)
        except BrokenOffError as error:
            raise self._damaged() from error

    def _note(self, topic: str, kind: str, count: int) -> None:
        figures = self.topics.setdefault(topic, TopicFigures(topic, kind))
        figures.types.add(kind)
        figures.count += count

    def _learn(self, definitions: list[tuple[str, MessageDefinition]]) -> None:
        """Add the types that the recording defines; its word goes before what is built in, for ROS 1 differs."""
        store = get_typestore(Stores.EMPTY)
        for name, definition in dict(definitions).items():
            if definition.format is MessageDefinitionFormat.NONE:
                continue
            try:
                store.register(_parse(name, definition))
            except Exception:  # noqa: BLE001 - a spoilt definition; its topic is then one of an unknown type
                self.broken = self.broken or f"Its definition of {name} is damaged."
        if any(figures.type not in store.fielddefs for figures in self.topics.values()):
            store.register({name: what for name, what in self._types.fielddefs.items() if name not in store.fielddefs})
        self._types = store

    def _damaged(self) -> BlockRobotError:
        detail = self.broken or "It is damaged or not a recording."
        return BlockRobotError("BAG_DAMAGED", f"The recording {self.path.name} cannot be read whole. {detail}")


def _defined(connections: list[Connection]) -> list[Connection]:
    return [connection for connection in connections if connection.msgdef.format is not MessageDefinitionFormat.NONE]


def _parse(name: str, definition: MessageDefinition) -> Any:
    if definition.format is MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    rule = "=" * 80 + "\n"
    if not definition.data.startswith(f"{rule}IDL: "):
        return get_types_from_idl(definition.data)
    types: dict[str, Any] = {}
    for part in definition.data.split(rule)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    return types


def _with_definitions(definitions: Mapping[str, str]) -> Typestore:
    store = typestore()
    for name, text in definitions.items():
        try:
            store.register(get_types_from_msg(text, name))
        except Exception as error:
            raise BlockRobotError("TOPICS_INVALID", f"The definition of {name} makes no sense.") from error
    return store


def _storage_files(path: Path) -> list[Path]:
    """Return the files of a recording in the order in which they were written. Raises BAG_DAMAGED if there are none."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES]
        found = sorted(files, key=lambda file: (len(file.name), file.name))  # ..._9 before ..._10
    else:
        found = [path] if path.is_file() and path.name.endswith(SUFFIXES) else []
    if not path.exists():
        raise BlockRobotError("FILE_UNUSABLE", f"There is no recording at {path}.")
    if not found:
        kinds = "a ROS 1 .bag, a rosbag2 folder, or one .mcap or .db3 file"
        raise BlockRobotError("BAG_DAMAGED", f"{path.name} is no recording that can be read: {kinds}.")
    return found
