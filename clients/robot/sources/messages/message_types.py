"""Message types: built-in, our own, recorded, or learnt live. Untrusted definitions that are too long never reach the slow
parser.
"""

from __future__ import annotations

import functools
import re
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clients.robot.sensing.message_names import typestore
from clients.robot.sources.messages.type_bounds import is_bounded
from consensus.errors import BlockRobotError

DEFINITION_MAX_CHARS = 256 * 1024
DEFINITION_MAX_WORDS = 4_000
"""Of one definition with all types in it, marks counted too, lines of comments not; ROS's largest have fewer than 500."""
WORD_MAX_CHARS = 256
DEFINITIONS_MAX_COUNT = 1_024
"""How many definitions of one recording are looked at."""
DEFINITIONS_MAX_WORK = 100_000
"""How many words all definitions of one recording may have, those of an IDL six times: some five seconds at most."""

_IDL_WORK = 6
_RULE = "=" * 80 + "\n"
_WORD = re.compile(r"\w+|[^\w\s]")
LEARNT_MAX_COUNT = 64
"""How many definitions of live publishers are kept; what is forgotten is parsed again when it is published again."""

Key = TypeVar("Key")
Value = TypeVar("Value")


class DefinitionTooLongError(Exception):
    """A definition is too long."""


def without_comments(text: str) -> str:
    """Without blank lines either."""
    kept = (line for line in text.split("\n") if line.strip() and not line.lstrip().startswith("#"))
    return "".join(f"{line}\n" for line in kept)


def count_work(definition: MessageDefinition) -> int:
    """Return a definition's parsing cost. Raises `DefinitionTooLongError`."""
    text = definition.data
    if len(text) > DEFINITION_MAX_CHARS:
        raise DefinitionTooLongError
    is_idl = definition.format is MessageDefinitionFormat.IDL
    count = 0
    for word in _WORD.finditer((text if is_idl else without_comments(text)).replace(_RULE, "\n")):
        count += 1
        if count > DEFINITION_MAX_WORDS or word.end() - word.start() > WORD_MAX_CHARS:
            raise DefinitionTooLongError
    return count * _IDL_WORK if is_idl else count


def parse_definition(name: str, definition: MessageDefinition) -> Any:
    """Call `count_work` first."""
    if definition.format is MessageDefinitionFormat.MSG:
        return get_types_from_msg(without_comments(definition.data), name)
    if not definition.data.startswith(f"{_RULE}IDL: "):
        return get_types_from_idl(definition.data)
    types: dict[str, Any] = {}
    for part in definition.data.split(_RULE)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    return types


@functools.cache
def own_types() -> Typestore:
    """Shared; do not modify."""
    return typestore()


def types_with(definitions: Mapping[str, str]) -> Typestore:
    """Return built-in and user types. Raises TOPICS_INVALID."""
    if not definitions:
        return own_types()
    store = typestore()
    for name, text in definitions.items():
        try:
            store.register(get_types_from_msg(text, name))
        except Exception as error:
            raise BlockRobotError("TOPICS_INVALID", f"The definition of {name} makes no sense.") from error
    return store


@dataclass(frozen=True, slots=True)
class Message:
    """One received message: `type` is `pkg/msg/Name`, `at_ns` host Unix ns, `data` ROS 1 or CDR."""

    topic: str
    type: str
    at_ns: int
    data: bytes


class MessageTypes:
    """Types by name, decoded from ROS 1 serialisation or CDR."""

    def __init__(self, store: Typestore, *, ros1: bool) -> None:
        self._store = store
        self._ros1 = ros1
        self._bounded: dict[str, bool] = {}

    def decode(self, message: Message) -> Any:
        """Raises FRAME_INVALID (`undecodable`)."""
        read = self._store.deserialize_ros1 if self._ros1 else self._store.deserialize_cdr
        try:
            if not self._is_bounded(message.type):
                raise ValueError(message.type)
            return read(message.data, message.type)
        except Exception as error:
            detail = f"A message of {message.topic} is no {message.type}."
            raise BlockRobotError("FRAME_INVALID", detail, reason="undecodable") from error

    def knows(self, type_name: str) -> bool:
        return type_name in self._store.types and self._is_bounded(type_name)

    def field_names(self, type_name: str) -> list[str]:
        return [name for name, _ in self._fields(type_name)]

    def paths(self, type_name: str, deep: int = 3) -> list[str]:
        """Return paths of plain fields: `epc`, `tags[].epc`; bytes are one value."""
        found = []
        for name, (kind, what) in self._fields(type_name):
            each = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            inner = what[0] if each else (kind, what)
            path = name + ("[]" if each and inner != (Nodetype.BASE, ("uint8", 0)) else "")
            if inner[0] is Nodetype.NAME:
                further = self.paths(str(inner[1]), deep - 1) if deep > 1 else []
                found += [f"{path}.{rest}" for rest in further if path.count("[]") + rest.count("[]") < 2]
            else:
                found.append(path)
        return found

    def has_path(self, type_name: str, path: str) -> bool:
        """Unknown types count as yes."""
        part, _, rest = path.partition(".")
        name, in_text = part.removesuffix("[]").removesuffix("{}"), "{}" in part
        fields = dict(self._fields(type_name))
        if not fields:
            return True
        if name not in fields:
            return False
        kind, what = fields[name]
        each = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        if in_text:  # what the text holds is known by its messages only
            return bool(kind is Nodetype.BASE and what[0] == "string")
        if part.endswith("[]") != each and (rest or not each):
            return False
        inner = what[0] if each else (kind, what)
        return not rest or (inner[0] is Nodetype.NAME and self.has_path(str(inner[1]), rest))

    def is_text(self, type_name: str, path: str) -> bool:
        part, _, rest = path.partition(".")
        for name, (kind, what) in self._fields(type_name):
            if name == part.removesuffix("[]"):
                inner = what[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, what)
                if rest:
                    return inner[0] is Nodetype.NAME and self.is_text(str(inner[1]), rest)
                return bool(inner[0] is Nodetype.BASE and inner[1][0] == "string")
        return False

    def _fields(self, type_name: str) -> list[Any]:
        return list(self._store.fielddefs[type_name][1]) if self.knows(type_name) else []

    def _is_bounded(self, type_name: str) -> bool:
        if type_name not in self._store.types:
            return True
        if type_name not in self._bounded:
            self._bounded[type_name] = is_bounded(type_name, self._store.fielddefs, ros1=self._ros1)
        return self._bounded[type_name]


class LearntTypes:
    """Live types: learnt, else user-defined, else ROS's. Thread-safe.

    Definitions are separate, since nodes may disagree on shared types; invalid or unbounded ones are ignored.
    """

    def __init__(self, known: Typestore, *, ros1: bool) -> None:
        self._ros1 = ros1
        self._known = MessageTypes(known, ros1=ros1)
        self._lock = threading.Lock()
        self._worked_out: OrderedDict[tuple[str, str], MessageTypes | None] = OrderedDict()
        self._newest: OrderedDict[str, MessageTypes | None] = OrderedDict()

    def learn(self, type_name: str, definition: str) -> bool:
        """Return whether it is valid."""
        with self._lock:
            types = self._work_out(type_name, definition)
            _keep(self._newest, type_name, types)
            return types is not None

    def of(self, type_name: str, definition: str = "") -> MessageTypes:
        """Return decoding types: by the message's definition, else the newest."""
        with self._lock:
            types = self._work_out(type_name, definition) if definition else self._newest.get(type_name)
        return types or self._known

    def _work_out(self, type_name: str, definition: str) -> MessageTypes | None:
        if len(definition) > DEFINITION_MAX_CHARS:
            return None
        key = type_name, without_comments(definition)  # another comment is no other type
        return _keep(self._worked_out, key, self._worked_out[key] if key in self._worked_out else self._parse(*key))

    def _parse(self, type_name: str, text: str) -> MessageTypes | None:
        store = get_typestore(Stores.EMPTY)
        definition = MessageDefinition(MessageDefinitionFormat.MSG, text)
        try:
            count_work(definition)
            store.register(parse_definition(type_name, definition))
        except Exception:  # noqa: BLE001 - a stranger's text fails in many ways
            return None
        types = MessageTypes(store, ros1=self._ros1)
        return types if types.knows(type_name) else None


def _keep(kept: OrderedDict[Key, Value], key: Key, value: Value) -> Value:
    kept[key] = value
    kept.move_to_end(key)
    if len(kept) > LEARNT_MAX_COUNT:
        kept.popitem(last=False)
    return value
