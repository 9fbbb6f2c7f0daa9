"""What commands answer with `--json`, held against what the reference page says of it: in both directions."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest

from clients.sdk.terminal.json_answers import Answer, AnswerLine, list_kinds
from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind
from network.cli.json_page import NOT_LISTED, SECTIONS, typed_answers
from network.cli.main import main

NOTING_FOLDER = Path(__file__).parent / "noted_answers"
FILE_VARIABLE = "BLOCKROBOT_TEST_ANSWERS_FILE"
HEXADECIMAL = re.compile(r"(?:[0-9a-f]{2})*")


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return _is_count(value) or isinstance(value, float)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hex(value: Any) -> bool:
    return isinstance(value, str) and HEXADECIMAL.fullmatch(value) is not None


def _is_list(value: Any, holds: Any) -> bool:
    return isinstance(value, list) and all(map(holds, value))


def _is_by_name(value: Any, holds: Any) -> bool:
    return isinstance(value, dict) and all(map(holds, value.values()))


CHECKS: Mapping[Kind, Any] = {
    Kind.TEXT: _is_text,
    Kind.HEX: _is_hex,
    Kind.BOOL: lambda value: isinstance(value, bool),
    Kind.COUNT: _is_count,
    Kind.NUMBER: _is_number,
    Kind.SECONDS: _is_number,
    Kind.MS: _is_number,
    Kind.TIME_MS: _is_count,
    Kind.HEIGHT: _is_count,
    Kind.OBJECT: lambda value: isinstance(value, dict),
    Kind.ROWS: lambda value: _is_list(value, lambda item: isinstance(item, dict)),
    Kind.TEXTS: lambda value: _is_list(value, _is_text),
    Kind.HEXES: lambda value: _is_list(value, _is_hex),
    Kind.COUNTS: lambda value: _is_list(value, _is_count),
    Kind.COUNTS_BY_NAME: lambda value: _is_by_name(value, _is_count),
    Kind.TEXTS_BY_NAME: lambda value: _is_by_name(value, _is_text),
    Kind.ROWS_BY_NAME: lambda value: _is_by_name(value, lambda item: isinstance(item, dict)),
}


def leaves(command: click.Command = main, path: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Command]]:
    """Walk the command line: every command that does something by itself, by its words behind `blockrobot`."""
    if not isinstance(command, click.Group) or command.invoke_without_command:
        yield " ".join(path), command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from leaves(below, (*path, name))


@cache
def words_of() -> dict[int, str]:
    """Return the words by which each command is called, by the command's identity: tests may call it without them."""
    return {id(command): words for words, command in leaves()}


@cache
def documented() -> dict[str, CommandAnswer]:
    """Return what the page says of each command."""
    return {words: answer for answers in SECTIONS.values() for answer in answers for words in answer.commands}


def is_elsewhere(words: str) -> bool:
    """Tell whether a command is one of those whose fields the page does not list."""
    return any(f"{words} ".startswith(f"{group} ") for group in NOT_LISTED)


def typed_differences(kind: type[Answer], told: Any) -> list[str]:
    """Return how an answer differs from its type: a wrong value, a field too few, or one too many."""
    told = json.loads(json.dumps(told))
    if not issubclass(kind, AnswerLine):
        ok = told.pop("ok", None)
        if ok is not True and (ok is not False or "`ok` is false" not in str(kind.__doc__)):
            return [f"ok is {ok}, which is not documented"]
    try:
        read = msgspec.convert(told, kind)
    except msgspec.ValidationError as error:
        return [str(error)]
    again = msgspec.to_builtins(read)
    return [] if again == told else [f"it has other fields than {kind.__name__}: {told!r}"]


def differences(words: str, told: Any) -> list[str]:
    """Return how an answer differs from what is documented of its command; nothing where the page lists no fields."""
    typed = typed_answers().get(words)
    if typed is not None:
        found = [typed_differences(kind, told) for kind in list_kinds(typed)]
        return [] if [] in found else [f"{words}: {line}" for lines in found for line in lines]
    answer = documented().get(words)
    if answer is None:
        return [] if is_elsewhere(words) else [f"{words or 'a command without a name'}: it is not documented"]
    told = json.loads(json.dumps(told))
    if not isinstance(told, dict):
        return [f"{words}: it is no object"]
    ok = told.pop("ok", None)
    if isinstance(ok, bool) != answer.has_ok or (ok is False and not answer.not_ok):
        return [f"{words}: ok is {ok}, which is not documented"]
    return [f"{words}: {line}" for line in _compare(answer.fields, told, "")]


def _compare(fields: tuple[Field, ...], told: dict[str, Any], above: str) -> Iterator[str]:
    known = {field.name: field for field in fields}
    for name in told.keys() - known.keys():
        yield f"{above}{name} is answered, and not documented"
    for name, field in known.items():
        place = f"{above}{name}"
        if name not in told:
            if not field.absent:
                yield f"{place} is documented, and not answered"
            continue
        value = told[name]
        if value is None:
            if not field.null:
                yield f"{place} is null, which is not documented"
        elif not CHECKS[field.kind](value):
            yield f"{place} is no {field.kind.value}: {value!r}"
        elif field.fields:
            for step, item in _objects(field.kind, value):
                yield from _compare(field.fields, item, f"{place}{step}.")


def _objects(kind: Kind, value: Any) -> list[tuple[str, dict[str, Any]]]:
    if kind is Kind.ROWS:
        return [("[]", item) for item in value]
    return [(".*", item) for item in value.values()] if kind is Kind.ROWS_BY_NAME else [("", value)]


@contextmanager
def answers_of_processes(file: Path) -> Iterator[None]:
    """While inside, every process that is started, and every one that those start, notes its answers in this file."""
    places = [str(NOTING_FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(places))
        patch.setenv(FILE_VARIABLE, str(file))
        yield


def read_noted(file: Path) -> list[tuple[str, Any]]:
    """Return what was noted: the words of each command, and its answer."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [(line["words"], line["told"]) for line in map(json.loads, lines)]


def noted_differences(file: Path) -> list[str]:
    """Return how the answers that were noted differ from what is documented, each way once."""
    return sorted({line for words, told in read_noted(file) for line in differences(words, told)})
