"""How moments are shown: in 24 hours, with the zone, in summer and in winter."""

from __future__ import annotations

import datetime
import re
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pages.time_format import format_clock, format_date, format_time, format_utc_time, local_time, parse_time

_SHOWN = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d) UTC(?:([+-]\d\d:\d\d))?")
WINTER_MS, SUMMER_MS = 1_801_418_400_200, 1_814_378_400_200  # 2027-01-31 18:00:00.2 and 2027-06-30 18:00:00.2 UTC


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("berlin")
def test_a_moment_has_its_zone_in_winter_and_in_summer() -> None:
    assert format_time(WINTER_MS) == "2027-01-31 19:00:00 UTC+01:00"
    assert format_time(SUMMER_MS) == "2027-06-30 20:00:00 UTC+02:00"
    assert format_utc_time(SUMMER_MS) == "2027-06-30 18:00:00 UTC"
    assert (format_clock(WINTER_MS), format_date(WINTER_MS)) == ("19:00:00.2", "2027-01-31")


@given(st.integers(0, 4_102_444_800_000))
def test_what_is_shown_names_one_second_only(time_ms: int) -> None:
    for shown in (format_time(time_ms), format_utc_time(time_ms)):
        found = _SHOWN.fullmatch(shown)
        assert found is not None
        moment = datetime.datetime.fromisoformat(found[1] + (found[2] or "+00:00"))
        assert int(moment.timestamp()) == time_ms // 1000
    assert local_time(time_ms).timestamp() == pytest.approx(time_ms / 1000)


@given(st.integers(0, 4_102_444_800_000))
def test_what_is_shown_can_be_typed_as_it_stands(time_ms: int) -> None:
    for shown in (format_time(time_ms), format_utc_time(time_ms)):
        assert parse_time(shown) == time_ms // 1000 * 1000


@pytest.mark.usefixtures("berlin")
def test_a_moment_without_a_zone_is_of_this_machine() -> None:
    assert parse_time(" 2027-06-30 20:00 ") == parse_time("2027-06-30T18:00:00Z") == SUMMER_MS // 1000 * 1000
    assert parse_time("2027-06-30") == parse_time("2027-06-30 00:00:00 UTC+02:00")


@pytest.mark.parametrize("written", ["", "half past nine", "2027-06-30 20:00 UTC+2", "9999-12-31 23:59:59 UTC-12:00"])
def test_what_is_no_moment_is_refused(written: str) -> None:
    with pytest.raises(ValueError, match="is no moment"):
        parse_time(written)
