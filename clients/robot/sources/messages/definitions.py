"""Parses untrusted type definitions; oversized ones never reach the slow parser."""

from __future__ import annotations

import re
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import get_types_from_idl, get_types_from_msg

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


class DefinitionTooLongError(Exception):
    """A definition is too long."""


def without_comments(text: str) -> str:
    """Return a .msg definition without comment and blank lines."""
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


def parse(name: str, definition: MessageDefinition) -> Any:
    """Return the defined types; call `count_work` first."""
    if definition.format is MessageDefinitionFormat.MSG:
        return get_types_from_msg(without_comments(definition.data), name)
    if not definition.data.startswith(f"{_RULE}IDL: "):
        return get_types_from_idl(definition.data)
    types: dict[str, Any] = {}
    for part in definition.data.split(_RULE)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    return types
