"""What a run of experiments says while it goes on: lines for people, JSON lines for programs.

Everything goes to standard error, so that standard output holds the one answer.
"""

from __future__ import annotations

import json
import time

import click
from rich.markup import escape

from clients.sdk.terminal.terminal import error_console
from network.demo.checks import Check
from network.demo.pacing import Pace
from network.experiments.definitions import Experiment


class Progress:
    """Tells a line at most every five seconds for as long as the stage is the same, and every check at once."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._pace = Pace()

    def tell(self, line: str) -> None:
        """Say what is being done; `experiment-1: run: 30 frames seen` is of the stage `experiment-1: run`."""
        if not self._pace.lets_pass(line, time.monotonic()):
            return
        click.echo(json.dumps({"progress": line}) if self._as_json else f"  {line}", err=True)

    def show(self, experiment: Experiment, check: Check) -> None:
        """Say what was checked."""
        if self._as_json:
            told = {"check": check.name, "ok": check.ok, "detail": check.detail, "experiment": experiment.number}
            click.echo(json.dumps(told), err=True)
        else:
            mark = "[green]✓[/green]" if check.ok else "[red]✗[/red]"
            error_console.print(f"{mark} {experiment.number}: {escape(check.name)}: {escape(check.detail)}")
