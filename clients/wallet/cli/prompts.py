"""Confirmation prompts."""

from __future__ import annotations

import click

from clients.sdk.terminal.terminal import ask, can_ask
from clients.wallet.presentation.translations import WrongUsage


def confirm_or_print(question: str, *, yes: bool, as_json: bool = False, explanation: str = "") -> None:
    """Announce `explanation` and ask, unless `yes`. Uses standard error beside JSON. Raises Abort, or UsageError without
    terminal.
    """
    if yes:
        return
    if not can_ask():
        raise WrongUsage("no_terminal_yes")
    if explanation:
        click.echo(explanation, err=True)
    ask(question, err=as_json or bool(explanation))
