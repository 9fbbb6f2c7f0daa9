"""Times of a command line: one notation for all commands."""

from __future__ import annotations

import click
import pytest

from clients.wallet.cli.times import MOMENT, read_time
from clients.wallet.commands.share_commands import read_end
from pages.time_format import parse_time

NOW_MS = 1_800_000_000_000
HOUR_MS = 3_600_000


def test_a_time_is_a_duration_from_now_or_a_date() -> None:
    assert read_time(None, NOW_MS) == 0
    assert read_time("+2h", NOW_MS) == NOW_MS + 2 * HOUR_MS
    assert read_time(" -7d ", NOW_MS) == NOW_MS - 7 * 24 * HOUR_MS
    assert read_time("+1h30m", NOW_MS) == NOW_MS + 3 * HOUR_MS // 2
    assert read_time("2027-01-31T18:00+00:00", NOW_MS) == 1_801_418_400_000
    assert read_time("2027-01-31", NOW_MS) < read_time("2027-01-31T18:00", NOW_MS)


@pytest.mark.parametrize(
    "text",
    [
        "soon",
        "+5",
        "2027-13-01",
        "",
        "7d",
        "+",
        "+7 d",
        "+1d2",
        "+" + "9" * 400 + "d",
        "-" + "9" * 400 + "d",
        "+9999999d",
    ],
)
def test_what_is_no_time_is_refused_with_how_one_is_written(text: str) -> None:
    with pytest.raises(click.UsageError, match=r"write 2027-01-31, .* \+30d or -12h"):
        read_time(text, NOW_MS)


@pytest.mark.parametrize("text", ["1969-12-31", "-9999999d"])
def test_a_time_before_1970_is_called_so(text: str) -> None:
    with pytest.raises(click.UsageError, match=r"is before 1970, .* write 2027-01-31, .* -30d"):
        read_time(text, NOW_MS)


@pytest.mark.parametrize("span", ["7 d", "7", "d", "a week", "7days", ""])
def test_a_span_in_another_notation_is_refused_with_how_one_is_written(span: str) -> None:
    with pytest.raises(click.UsageError, match="a number and m, h, d or w, without a blank: 90m, 12h, 7d, 2w"):
        read_end(span, None, NOW_MS)


def test_an_officer_gives_a_date_and_a_time() -> None:
    assert MOMENT.convert("2026-03-01 09:30", None, None) == parse_time("2026-03-01T09:30")
    with pytest.raises(click.BadParameter):
        MOMENT.convert("+5d", None, None)
