"""Progress of an export or a check, for who watches a terminal. Must never write where a program reads."""

from __future__ import annotations

import sys
import time

import click

from clients.bundle.proving import Heard, never_heard


def show_progress(*, quiet: bool) -> Heard:
    """Return what tells of progress on a terminal, on standard error, at most four times a second."""
    if quiet or not sys.stderr.isatty():
        return never_heard
    last = 0.0

    def hear(what: str, done: int, of: int) -> None:
        nonlocal last
        now = time.monotonic()
        if done < of and now - last > 0.25:
            last = now
            click.echo(f"\r{what}: {100 * done // of} %\x1b[K", nl=False, err=True)
        elif done == of:
            click.echo("\r\x1b[K", nl=False, err=True)

    return hear
