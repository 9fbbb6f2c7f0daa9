"""Asks before something is done."""

from __future__ import annotations

import sys

import click

from clients.sdk.terminal.terminal import ask
from clients.wallet.present.translations import WrongUsage


def ask_or_say(question: str, *, yes: bool, as_json: bool = False, told: str = "") -> None:
    """Say what is about to happen, if that is `told`, and ask, unless `--yes` said so.

    Beside JSON, and after what is told, the question goes to standard error. Raises Abort for no, and UsageError where
    there is nobody to ask.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise WrongUsage("no_terminal_yes")
    if told:
        click.echo(told, err=True)
    ask(question, err=as_json or bool(told))
