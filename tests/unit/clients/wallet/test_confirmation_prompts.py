"""A yes in the person's own language: what a question takes for yes, for no, and for neither."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from clients.sdk.terminal.terminal import ask
from clients.wallet.cli.group_options import wallet_options


@click.command()
@wallet_options
def leave(**_options: object) -> None:
    """Ask, and tell that it was done."""
    ask("Sair?")
    click.echo("feito")


@pytest.mark.parametrize("said", ["s", "Sim", " SIM ", "y"])
def test_a_portuguese_yes_is_a_yes(said: str) -> None:
    done = CliRunner().invoke(leave, ["--language", "pt"], input=f"{said}\n")
    assert done.exit_code == 0
    assert "Sair? [s/N]: " in done.output
    assert "feito" in done.output


@pytest.mark.parametrize("said", ["", "n", "Não", "nao"])
def test_a_portuguese_no_or_nothing_is_a_no(said: str) -> None:
    done = CliRunner().invoke(leave, ["--language", "pt"], input=f"{said}\n")
    assert (done.exit_code, "feito" in done.output) == (1, False)


def test_what_is_neither_is_asked_again() -> None:
    done = CliRunner().invoke(leave, ["--language", "pt"], input="talvez\ns\n")
    assert done.exit_code == 0
    assert done.output.count("Sair?") == 2
    assert "Responda s (sim) ou n (não)." in done.output


def test_an_english_question_is_asked_as_ever() -> None:
    done = CliRunner().invoke(leave, ["--language", "en"], input="maybe\nyes\n")
    assert "Sair? [y/N]: " in done.output
    assert "Error: invalid input" in done.output
    assert done.exit_code == 0


def test_nobody_at_the_terminal_says_no() -> None:
    assert CliRunner().invoke(leave, ["--language", "pt"], input="").exit_code == 1
