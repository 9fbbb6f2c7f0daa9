"""The commands and their reference: each says how it is called, and the page knows every option."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from clients.sdk.terminal.lazy_group import LazyGroup
from network.cli.main import SECTIONS, main

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "cli.md"


def commands(group: click.Group, path: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Command]]:
    """Yield every command below a group by the words that call it: groups, and hidden ones, too."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        yield " ".join((*path, name)), command
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))


EVERY = dict(commands(main))
LEAVES = {words: command for words, command in EVERY.items() if not isinstance(command, click.Group)}


def test_all_commands_are_looked_at() -> None:
    assert len(LEAVES) > 60
    assert {"wallet probe", "org propose add-org", "node snapshot create"} <= set(LEAVES)


def first_paragraph(command: click.Command) -> str:
    return " ".join(inspect.cleandoc(command.help or "").split("\n\n")[0].split())


def test_the_lists_of_commands_say_what_the_commands_say() -> None:
    """A list is shown without an import, so it has its own copy of each command's first paragraph."""
    said, meant = {}, {}
    for words, group in GROUPS.items():
        if isinstance(group, LazyGroup):
            for name, place in group.places.items():
                command = group.get_command(click.Context(group), name)
                assert command is not None
                said[words, name] = place.summary, place.hidden
                meant[words, name] = first_paragraph(command), command.hidden
    assert said == meant
    assert {"", "wallet", "node", "contract", "custody"} <= {words for words, _ in said}


def test_the_help_has_every_command_once_by_who_uses_it() -> None:
    named = [name for names in SECTIONS.values() for name in names]
    assert sorted(named) == sorted(main.list_commands(click.Context(main)))
    shown = CliRunner().invoke(main, ["--help"]).output
    headings = [shown.index(f"{heading}:\n") for heading in SECTIONS]
    assert headings == sorted(headings)
    lines = shown[headings[0] :].splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "] == named


GROUPS = {"": main, **{words: command for words, command in EVERY.items() if isinstance(command, click.Group)}}


@pytest.mark.parametrize("words", GROUPS)
def test_an_unknown_command_is_answered_with_those_that_are_spelt_alike(words: str) -> None:
    group = GROUPS[words]
    for name in group.list_commands(click.Context(group)):
        told = CliRunner().invoke(main, [*words.split(), f"{name[:-1]}x{name[-1]}"])
        assert told.exit_code == 2
        assert "Did you mean" in told.output
        assert f"'{name}'" in told.output


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("recrods", "No such command 'recrods'. Did you mean 'wallet records'?"),
        ("records", "Did you mean one of: 'wallet records', "),
        ("walet", "(Did you mean one of: 'wallet', 'fault'"),
        ("zzzzzzzz", "No such command 'zzzzzzzz'.\n"),
    ],
)
def test_an_unknown_command_is_looked_for_in_every_group_and_the_nearest_comes_first(typed: str, said: str) -> None:
    told = CliRunner().invoke(main, [typed])
    assert (told.exit_code, said in told.output) == (2, True), told.output


@pytest.mark.parametrize("words", [words for words, group in GROUPS.items() if isinstance(group, LazyGroup)])
def test_no_sentence_of_a_list_of_commands_is_cut(words: str) -> None:
    shown = CliRunner().invoke(main, [*words.split(), "--help"]).output
    assert "..." not in shown.partition("Options:")[2].replace("BR1-...", "")


@pytest.mark.parametrize("words", LEAVES)
def test_every_command_shows_how_it_is_called(words: str) -> None:
    shown = LEAVES[words].get_help(click.Context(LEAVES[words], info_name=words))
    text = " ".join(shown.split())
    assert "Example" in text
    assert f"blockrobot {words}" in text[text.index("Example") :]
    assert all(line.count("Example:") <= 1 for line in shown.splitlines()), "each on a line of its own"


@pytest.mark.parametrize("words", LEAVES)
def test_the_reference_names_every_option(words: str) -> None:
    page = PAGE.read_text(encoding="utf-8")
    options = [option for option in LEAVES[words].params if isinstance(option, click.Option)]
    names = [name for option in options for name in option.opts if name.startswith("--")]
    assert [name for name in names if not any(name + end in page for end in ("`", " ", "]"))] == []


@pytest.mark.parametrize("words", LEAVES)
def test_the_reference_names_every_command(words: str) -> None:
    page = PAGE.read_text(encoding="utf-8")
    first, *rest = words.split()
    assert f"`{words}" in page or (f"`{first}" in page and all(part in page for part in rest))
