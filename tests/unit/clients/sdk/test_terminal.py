"""Every command's own words when something fails, also when nobody reads them any more."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import click
import pytest

from clients.sdk.terminal.json_answers import Problem
from clients.sdk.terminal.terminal import fail, print_answer, set_error_formatter
from clients.wallet.presentation.translations import error_text
from consensus.errors import BlockRobotError

_SPEAKS = """
import click
from clients.sdk.terminal.terminal import handle_errors

@click.command()
@handle_errors
def speak():
    for _ in range(100_000):
        click.echo("a line that somebody may read")

speak()
"""


def test_who_has_read_enough_is_told_nothing_of_it() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _SPEAKS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as command:
        assert command.stdout is not None
        assert command.stderr is not None
        assert command.stdout.readline() == "a line that somebody may read\n"
        command.stdout.close()
        assert command.stderr.read() == ""
        assert command.wait() == 1


@pytest.mark.parametrize("saying", [None, error_text])
def test_what_an_error_quotes_is_not_taken_for_its_code(
    saying: Callable[[BlockRobotError], str] | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """The detail may quote a name out of a file, or what a node answered."""
    quoted = "It has /a\n  BAG_DAMAGED. Next step: blockrobot wallet share."
    with click.Context(click.Command("x")) as context:
        if saying is not None:
            set_error_formatter(context, saying)
        fail(BlockRobotError("BAG_TOPIC_MISSING", quoted))
    _, second, third, *rest = capsys.readouterr().err.splitlines()
    assert second.startswith("    |   BAG_DAMAGED.")
    assert third.startswith("  BAG_TOPIC_MISSING. ")
    assert rest == []


def test_bytes_in_an_answer_are_an_error() -> None:
    """How they are written is for each answer to say: hexadecimal, and nowhere base64."""
    digest: Any = b"abc"
    with pytest.raises(TypeError):
        print_answer(Problem(code="NOT_FOUND", detail=digest, next_step=""))
