"""Every command's own words when something fails, also when nobody reads them any more."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from clients.sdk.terminal.json_answers import Problem
from clients.sdk.terminal.terminal import print_answer

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


def test_bytes_in_an_answer_are_an_error() -> None:
    """How they are written is for each answer to say: hexadecimal, and nowhere base64."""
    digest: Any = b"abc"
    with pytest.raises(TypeError):
        print_answer(Problem(code="NOT_FOUND", detail=digest, next_step=""))
