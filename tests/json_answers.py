"""What commands answer with `--json`, held against what the reference page says of it: in both directions."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest

from clients.sdk.terminal.json_answers import Answer, AnswerLine, list_kinds
from network.cli.json_reference import NOT_LISTED, listed_answers
from network.cli.main import main

NOTING_FOLDER = Path(__file__).parent / "noted_answers"
FILE_VARIABLE = "BLOCKROBOT_TEST_ANSWERS_FILE"


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
    typed = listed_answers().get(words)
    if typed is not None:
        found = [typed_differences(kind, told) for kind in list_kinds(typed)]
        return [] if [] in found else [f"{words}: {line}" for lines in found for line in lines]
    return [] if is_elsewhere(words) else [f"{words or 'a command without a name'}: it is not documented"]


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
