"""The commands and their reference: each says how it is called, and the page knows every option."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from network.cli.main import main

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


@pytest.mark.parametrize("words", LEAVES)
def test_every_command_shows_how_it_is_called(words: str) -> None:
    text = " ".join(LEAVES[words].get_help(click.Context(LEAVES[words], info_name=words)).split())
    assert "Example" in text
    assert f"blockrobot {words}" in text[text.index("Example") :]


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
