"""How a moment is shown: 24 hours, seconds, UTC offset (as `assets/format.js`)."""

from __future__ import annotations

import datetime
import re

_DAY = "%Y-%m-%d"
_CLOCK = "%H:%M:%S"
_OFFSET = re.compile(r"\s+UTC([+-]\d\d:\d\d)?$", re.ASCII)


def local_time(time_ms: int) -> datetime.datetime:
    """Return milliseconds since 1970 as this machine's local time."""
    return datetime.datetime.fromtimestamp(time_ms / 1000).astimezone()


def show_moment(time_ms: int) -> str:
    """Return `2027-01-31 09:05:00 UTC+01:00`, in this machine's time zone."""
    return _with_offset(local_time(time_ms))


def show_utc_moment(time_ms: int) -> str:
    """Return `2027-01-31 08:05:00 UTC`, for logs and reproducible documents."""
    return _with_offset(datetime.datetime.fromtimestamp(time_ms / 1000, datetime.UTC))


def show_clock(time_ms: int) -> str:
    """Return `09:05:00.2`, in this machine's time zone."""
    return local_time(time_ms).strftime(_CLOCK) + f".{time_ms % 1000 // 100}"


def show_day(time_ms: int) -> str:
    return local_time(time_ms).strftime(_DAY)


def read_moment(written: str) -> int:
    """Return milliseconds from these functions' output or ISO 8601; default zone local.

    Raises ValueError.
    """
    text = _OFFSET.sub(lambda found: found[1] or "+00:00", written.strip())
    try:
        return round(datetime.datetime.fromisoformat(text).astimezone().timestamp() * 1000)
    except (ValueError, OverflowError, OSError) as error:
        raise ValueError(f"{written!r} is no moment.") from error


def _with_offset(moment: datetime.datetime) -> str:
    # An abbreviation would not do: IST is Dublin, Jerusalem and Delhi, and some zones have none.
    offset = datetime.timezone(moment.utcoffset() or datetime.timedelta())
    return f"{moment:{_DAY} {_CLOCK}} {offset}"
