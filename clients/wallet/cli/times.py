"""How times are written on a command line: a date, a date with a time, or a duration from now (`pages.time_format`)."""

from __future__ import annotations

from typing import Any

import click

from clients.wallet.presentation.translations import WrongUsage
from pages.time_format import parse_time


def read_time(written: str | None, now_ms: int) -> int:
    """Return ms since 1970, 0 for none. Raises UsageError, also for a time before 1970 or after 9998."""
    if written is None:
        return 0
    try:
        moment_ms = parse_time(written, now_ms)
    except ValueError:
        raise WrongUsage("no_time", given=written) from None
    if moment_ms <= 0:
        raise WrongUsage("before_1970", given=written)
    return moment_ms


class TimeParamType(click.ParamType[int]):
    """A time on the command line, as ms since 1970."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        try:
            return parse_time(value)
        except ValueError:
            self.fail('Give a date, or a date and a time, as "2027-01-31 18:00".', param, ctx)


MOMENT = TimeParamType()
