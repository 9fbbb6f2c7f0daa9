"""How a moment is shown (24 hours, seconds, UTC offset, as `assets/format.js`), and how moments and durations are read."""

from __future__ import annotations

import datetime
import math
import re

_DAY = "%Y-%m-%d"
_CLOCK = "%H:%M:%S"
UNITS_MS = {"ms": 1, "s": 1_000, "m": 60_000, "min": 60_000, "h": 3_600_000, "d": 86_400_000, "w": 7 * 86_400_000}
_DURATION = re.compile(r"([+-]?)((?:\d+(?:\.\d+)?(?:ms|min|[smhdw]))+)", re.ASCII)
_PART = re.compile(r"(\d+(?:\.\d+)?)(ms|min|[smhdw])", re.ASCII)
_SHOWN_MAX_MS = 253_370_764_800_000  # 9999-01-01: what later functions cannot show is not read
_OFFSET = re.compile(r"\s+UTC([+-]\d\d:\d\d)?$", re.ASCII)


def local_time(time_ms: int, zone: datetime.tzinfo | None = None) -> datetime.datetime:
    """Return milliseconds since 1970 in a time zone, this machine's by default."""
    return datetime.datetime.fromtimestamp(time_ms / 1000, zone).astimezone(zone)


def format_time(time_ms: int) -> str:
    """Return `2027-01-31 09:05:00 UTC+01:00`, in this machine's time zone."""
    return _with_offset(local_time(time_ms))


def format_utc_time(time_ms: int) -> str:
    """Return `2027-01-31 08:05:00 UTC`, for logs and reproducible documents."""
    return _with_offset(datetime.datetime.fromtimestamp(time_ms / 1000, datetime.UTC))


def format_clock(time_ms: int) -> str:
    """Return `09:05:00.2`, in this machine's time zone."""
    return local_time(time_ms).strftime(_CLOCK) + f".{time_ms % 1000 // 100}"


def format_date(time_ms: int) -> str:
    return local_time(time_ms).strftime(_DAY)


def parse_duration(written: str) -> int:
    """Return the ms of a duration such as `250ms`, `-90s`, `1h30m`, `7d` or `2w`. Raises ValueError."""
    found = _DURATION.fullmatch(written.strip())
    total_ms = sum(float(number) * UNITS_MS[unit] for number, unit in _PART.findall(found[2])) if found else math.inf
    if found is None or not math.isfinite(total_ms):
        raise ValueError(f"{written!r} is no duration.")
    return round(-total_ms if found[1] == "-" else total_ms)


def parse_time(written: str, now_ms: int | None = None) -> int:
    """Return the ms since 1970 of what these functions show, or of an ISO 8601 date with or without a time.

    A moment that names no zone is of this machine's. With `now_ms`, also a duration with its sign: `+30d`, `-12h`.
    Raises ValueError.
    """
    text = written.strip()
    if now_ms is not None and text[:1] in ("+", "-"):
        moment_ms = now_ms + parse_duration(text)
        if moment_ms > _SHOWN_MAX_MS:
            raise ValueError(f"{written!r} is beyond the year 9999.")
        return moment_ms
    text = _OFFSET.sub(lambda found: found[1] or "+00:00", text)
    try:
        return round(datetime.datetime.fromisoformat(text).astimezone().timestamp() * 1000)
    except (ValueError, OverflowError, OSError) as error:
        raise ValueError(f"{written!r} is no moment.") from error


def _with_offset(moment: datetime.datetime) -> str:
    # An abbreviation would not do: IST is Dublin, Jerusalem and Delhi, and some zones have none.
    offset = datetime.timezone(moment.utcoffset() or datetime.timedelta())
    return f"{moment:{_DAY} {_CLOCK}} {offset}"
