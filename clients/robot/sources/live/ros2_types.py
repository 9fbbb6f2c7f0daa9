"""Definitions and REP 2011 hashes of ROS 2's generated Python types.

Type names are untrusted: only `PKG.msg` is ever imported.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NESTED_MAX_COUNT = 256
"""The most types that one may consist of."""

_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)", re.ASCII)
_NESTED = re.compile(r"([a-z][a-z0-9_]*)/([A-Z][A-Za-z0-9]*)", re.ASCII)
_LIST = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_TEXT = re.compile(r"string<(\d+)>")
_PLAIN = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
_KEPT = frozenset({"string", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"})


class NotFoundError(Exception):
    """Python finds no such type; the text is a sentence's second half."""


@dataclass(frozen=True, slots=True)
class RosType:
    """A generated class, full definition, and hash (empty if unknown)."""

    python_class: Any
    definition: str
    hash: str

    def is_other(self, hashes: set[str]) -> bool:
        """Return whether a published hash differs from this type's."""
        return bool(self.hash and hashes - {self.hash})


def load(type_name: str) -> RosType:
    """As `pkg/msg/Name`. Raises NotFoundError."""
    python_class = _find(type_name)
    _load_libraries(type_name, python_class)
    definition = definition_of(type_name, python_class)
    return RosType(python_class, definition, _hash(type_name, definition))


def definition_of(type_name: str, python_class: Any) -> str:
    """As in rosbag2. Raises NotFoundError."""
    texts: dict[str, str] = {}
    waiting = [(type_name, python_class)]
    while waiting:
        name, found = waiting.pop()
        if name in texts:
            continue
        if len(texts) >= NESTED_MAX_COUNT:
            raise NotFoundError(f"it consists of more than {NESTED_MAX_COUNT} types")
        lines = []
        for field, kind in found.get_fields_and_field_types().items():
            text, nested = _field_type(kind)
            lines.append(f"{text} {field}")
            if nested:
                waiting.append((nested, _find(nested)))
        texts[name] = "\n".join(lines) + "\n"
    first, *others = texts.items()
    rule = "=" * 80
    return first[1] + "".join(f"{rule}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)


def _find(type_name: str) -> Any:
    parts = _NAME.fullmatch(type_name)
    if parts is None:
        raise NotFoundError("that is no name of a message type")
    package, name = parts.groups()
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except Exception as error:  # a package of another Python or another ROS fails in many ways
        raise _not_importable(error) from error


def _load_libraries(type_name: str, python_class: Any) -> None:
    """Load a package's compiled type support. Raises NotFoundError."""
    try:
        if python_class._TYPE_SUPPORT is None:
            python_class.__import_type_support__()
    except Exception as error:
        raise _not_importable(error) from error
    if python_class._TYPE_SUPPORT is None:  # generated code swallows an ImportError
        raise NotFoundError(f"the libraries of {type_name.partition('/')[0]} cannot be loaded")


def _not_importable(error: Exception) -> NotFoundError:
    return NotFoundError(f"Python cannot import it ({str(error)[:200]})")


def _field_type(kind: str) -> tuple[str, str]:
    """Return a field's `.msg` type and its message type, if any."""
    if found := _LIST.fullmatch(kind):
        text, nested = _field_type(found[1])
        return f"{text}[{'<=' + found[2] if found[2] else ''}]", nested
    if found := _ARRAY.fullmatch(kind):
        text, nested = _field_type(found[1])
        return f"{text}[{found[2]}]", nested
    if found := _TEXT.fullmatch(kind):
        return f"string<={found[1]}", ""
    if kind in _PLAIN or kind in _KEPT:
        return _PLAIN.get(kind, kind), ""
    if found := _NESTED.fullmatch(kind):
        return kind, f"{found[1]}/msg/{found[2]}"
    raise NotFoundError(f"a field of it is of a kind that the robot does not read, {kind[:64]!r}")


def _hash(type_name: str, definition: str) -> str:
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(definition, type_name))
        return str(store.hash_rihs01(type_name))
    except Exception:  # noqa: BLE001 - what rosbags cannot hash cannot be compared, and nothing else is lost
        return ""
