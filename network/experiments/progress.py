"""Progress of experiments on standard error: text lines or JSON lines."""

from __future__ import annotations

import json
import time

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import error_console
from network.demo.checks import Check, ProgressThrottle
from network.experiments.definitions import Experiment


class Progress:
    """Prints at most one line per five seconds and stage, and every check."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._pace = ProgressThrottle()

    def tell(self, line: str) -> None:
        if not self._pace.lets_pass(line, time.monotonic()):
            return
        click.echo(json.dumps({"progress": line}) if self._as_json else f"  {line}", err=True)

    def show(self, experiment: Experiment, check: Check) -> None:
        if self._as_json:
            document = {"check": check.name, "ok": check.ok, "detail": check.detail, "experiment": experiment.number}
            click.echo(json.dumps(document), err=True)
        else:
            mark = "[green]✓[/green]" if check.ok else "[red]✗[/red]"
            error_console.print(f"{mark} {experiment.number}: {escape(check.name)}: {escape(check.detail)}")
