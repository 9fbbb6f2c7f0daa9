"""Descriptions of commands' `--json` fields, for the reference page and tests."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass


class Kind(enum.Enum):
    """A field's kind, as worded on the reference page."""

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
    """A field of an answer or object; `null` and `absent` say when, `fields` describe nested objects."""

    name: str
    kind: Kind
    meaning: str
    null: str = ""
    absent: str = ""
    fields: tuple[Field, ...] = ()


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """The `--json` answer of commands. `not_ok` explains when `ok` is false without error; `lines` describes further
    output.
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
    lines = ["### " + ", ".join(f"`{command}`" for command in answer.commands), ""]
    if answer.lines:
        lines += [answer.lines, ""]
    if answer.not_ok:
        lines += [f"`ok` is false {answer.not_ok}.", ""]
    if not answer.fields:
        return [*lines, "Nothing but `ok`.", ""]
    return [*lines, "| field | type | meaning | |", "|---|---|---|---|", *_rows(answer.fields, ""), ""]
