"""What documents tell people to type can be typed: each command in a fence is there, with its options and arguments."""

from __future__ import annotations

import re
import shlex

import click
import pytest

from network.cli.main import main
from tests.architecture.test_named_in_documents import documents

TYPED = re.compile(r"^(?:[A-Z_]+=\S+ )*(?:\.venv/bin/)?blockrobot (.*)$")
FENCE = re.compile(r"^```(?:sh|bash)?(?: [a-z ]+)?\n(.*?)^```", re.MULTILINE | re.DOTALL)
ENDS_OF_A_COMMAND = frozenset({"|", "&&", ";", ">"})


def typed_in(text: str) -> list[str]:
    """Return the commands of BlockRobot in a document's fences, without `blockrobot`."""
    lines = "\n".join(FENCE.findall(text)).splitlines()
    return [found[1] for line in lines if (found := TYPED.match(line))]


def fault_of(typed: str) -> str | None:
    """Return why a command cannot be typed so, None if it can. Values stand for others: they are not looked at."""
    try:
        words = shlex.split(typed, comments=True)
        end = next((place for place, word in enumerate(words) if word in ENDS_OF_A_COMMAND), len(words))
        command: click.Command = main
        rest = words[:end]
        while True:
            with click.Context(command) as context:
                _, rest, _ = command.make_parser(context).parse_args(rest)
                inner = command.get_command(context, rest[0]) if isinstance(command, click.Group) and rest else None
            if inner is None:
                return f"{command.name} takes no {rest[0]}" if rest else None
            command, rest = inner, rest[1:]
    except (ValueError, click.UsageError) as error:
        return str(error)


@pytest.mark.parametrize(
    ("typed", "part"),
    [
        ("walet new", "takes no walet"),
        ("wallet new --word-file x", "--word-file"),
        ("wallet --profile", "--profile"),
        ("notice check notice.toml     is it complete?", "takes no is"),
        ("notice new notice.toml       the hospital's", "quotation"),
    ],
)
def test_the_check_finds_what_cannot_be_typed(typed: str, part: str) -> None:
    assert typed_in(f"```sh\ncd x\nblockrobot {typed}\n```\n") == [typed]
    assert part in (fault_of(typed) or "")


def test_every_command_in_a_fence_can_be_typed() -> None:
    found = {(name, typed): fault_of(typed) for name, text in documents().items() for typed in typed_in(text)}
    assert len(found) > 100
    assert {place: fault for place, fault in found.items() if fault} == {}
