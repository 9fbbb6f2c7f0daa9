"""How a command says which fields its `--json` answer has: the catalogues beside the commands are made of these.

The reference page is written from them, and the tests hold what commands really answer against them.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass


class Kind(enum.Enum):
    """What a field holds, in the words of the reference page."""

    TEXT = "text"
    HEX = "hexadecimal"
    BOOL = "true or false"
    COUNT = "whole number"
    NUMBER = "number"
    SECONDS = "seconds"
    MS = "milliseconds"
    TIME_MS = "time in ms"
    HEIGHT = "block height"
    OBJECT = "object"
    ROWS = "list of objects"
    TEXTS = "list of texts"
    HEXES = "list of hexadecimal"
    COUNTS = "list of whole numbers"
    COUNTS_BY_NAME = "object of whole numbers"
    TEXTS_BY_NAME = "object of texts"
    ROWS_BY_NAME = "object of objects"


@dataclass(frozen=True, slots=True)
class Field:
    """One field of an answer, or of an object in it.

    `null` and `absent` say when it is null, and when it is left out; without them it never is. `fields` are those of
    the object, or of each object in the list or under a name; an object without any is described where `meaning` says.
    """

    name: str
    kind: Kind
    meaning: str
    null: str = ""
    absent: str = ""
    fields: tuple[Field, ...] = ()


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """What commands answer with `--json`: the same fields for all that are named.

    `ok` is in every answer that `has_ok`. `not_ok` says when it is false without the command having been refused.
    `lines` says what more is printed, or when, where that is not one object at the end.
    """

    commands: tuple[str, ...]
    fields: tuple[Field, ...]
    not_ok: str = ""
    lines: str = ""
    has_ok: bool = True


_BELOW = {Kind.ROWS: "[]", Kind.ROWS_BY_NAME: ".*"}


def _rows(fields: Iterable[Field], above: str) -> list[str]:
    rows = []
    for field in fields:
        name = f"{above}{field.name}"
        when = "; ".join(
            f"{word} {condition}" for word, condition in (("null", field.null), ("absent", field.absent)) if condition
        )
        rows.append(f"| `{name}` | {field.kind.value} | {field.meaning} | {when} |")
        rows += _rows(field.fields, f"{name}{_BELOW.get(field.kind, '')}.")
    return rows


def write_section(answer: CommandAnswer) -> list[str]:
    """Return the lines of Markdown that describe one answer."""
    lines = ["### " + ", ".join(f"`{command}`" for command in answer.commands), ""]
    if answer.lines:
        lines += [answer.lines, ""]
    if answer.not_ok:
        lines += [f"`ok` is false {answer.not_ok}.", ""]
    if not answer.fields:
        return [*lines, "Nothing but `ok`.", ""]
    return [*lines, "| field | type | meaning | |", "|---|---|---|---|", *_rows(answer.fields, ""), ""]
