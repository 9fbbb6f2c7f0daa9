"""Confirmation prompts."""

from __future__ import annotations

import click

from clients.sdk.terminal.terminal import ask, can_ask
from clients.wallet.present.translations import WrongUsage


def ask_or_say(question: str, *, yes: bool, as_json: bool = False, told: str = "") -> None:
    """Announce `told` and ask, unless `yes`. Uses standard error beside JSON. Raises Abort, or UsageError without
    terminal.
    """
    if yes:
        return
    if not can_ask():
        raise WrongUsage("no_terminal_yes")
    if told:
        click.echo(told, err=True)
    ask(question, err=as_json or bool(told))
