"""Options that choose records: a day, a time of day, robots, sensors."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence

from clients.wallet.ledger.record_filter import Filter
from clients.wallet.presentation.translations import WrongUsage
from consensus.records.metadata import NOTICE_SENSOR
from consensus.rights.sensors import require_sensor

PARTS_OF_DAY = {"night": (0, 6), "morning": (6, 12), "afternoon": (12, 18), "evening": (18, 24)}
"""Hours of this machine's time zone: from the first on, up to the second."""
_DAY_MINUTES = 24 * 60
_TIMES = re.compile(r"(\d{1,2}):(\d\d)-(\d{1,2}):(\d\d)")


def read_days(written: str | None, today: datetime.date) -> tuple[datetime.date, datetime.date] | None:
    """`today`, `yesterday`, `2027-01-31` or `2027-01-01..2027-01-31`."""
    if written is None:
        return None

    def day(name: str) -> datetime.date:
        named = {"today": today, "yesterday": today - datetime.timedelta(days=1)}
        return named.get(name.strip()) or datetime.date.fromisoformat(name.strip())

    try:
        first, _, last = written.partition("..")
        days = (day(first), day(last or first))
    except ValueError:
        raise WrongUsage("no_day", given=written) from None
    if days[0] > days[1]:
        raise WrongUsage("day_order")
    return days


def read_minutes(written: str | None) -> tuple[int, int] | None:
    """`morning` etc. or `09:00-12:30`, as minutes of day."""
    if written is None:
        return None
    if written in PARTS_OF_DAY:
        first, end = PARTS_OF_DAY[written]
        return first * 60, end * 60
    found = _TIMES.fullmatch(written.strip())
    if found:
        begin_hour, begin_minute, end_hour, end_minute = map(int, found.groups())
        first, end = begin_hour * 60 + begin_minute, end_hour * 60 + end_minute
        if first < _DAY_MINUTES and end <= _DAY_MINUTES and first != end and begin_minute < 60 and end_minute < 60:
            return first, end
    raise WrongUsage("no_time_of_day", given=written, known=", ".join(PARTS_OF_DAY))


def read_filter(
    day: str | None, time_of_day: str | None, robots: Sequence[str], sensors: Sequence[str], today: datetime.date
) -> Filter:
    """Raises UsageError, SENSOR_UNKNOWN."""
    for sensor in sensors:
        if sensor != NOTICE_SENSOR:
            require_sensor(sensor)
    named = tuple(robot.lower() for robot in robots)
    days = read_days(day, today)
    return Filter(days and (str(days[0]), str(days[1])), read_minutes(time_of_day), named, tuple(sensors))
