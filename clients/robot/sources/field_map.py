"""Reads tag sightings, labels and sound out of messages of any type, by a map that names the path of each field.

There is no standard ROS message for RFID, so the user says where things stand: `epc = "ids[]"`, `rssi = "dbs[]"`. A
path goes through fields by `.`; `[]` behind a field means each of its entries. Must never run anything that a file or
a message says: a path only reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clients.robot.events import Facing, Sighting
from clients.robot.sources.source import NS_PER_MS
from consensus.errors import BlockRobotError

EPC_MAX_CHARS = 64
READINGS_MAX_COUNT = 16_384
"""The most readings that one message may hold."""

SEEN_MAX_MS = 60_000
"""The longest time over which one reading may say that its tag was seen; pairing remembers no longer."""

TIME_UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
LENGTH_UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
RSSI_UNITS_DBM = {"dBm": 1.0, "cdBm": 0.01}

_PATH = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\[\])?(\.[A-Za-z_][A-Za-z0-9_]*(\[\])?)*")
_MISSING = object()


def check_path(path: str, name: str) -> str:
    """Return `path` if it can be one. Raises TOPICS_INVALID naming the setting."""
    if not _PATH.fullmatch(path) or path.count("[]") > 1:
        raise BlockRobotError(
            "TOPICS_INVALID", f"{name} = {path!r} is no path of fields, such as tag.epc or ids[] (at most one [])."
        )
    return path


def read_path(message: Any, path: str) -> Any:
    """Return the value at a path, a list for a path with `[]`. Raises FRAME_INVALID if there is none."""
    value = _walk(message, path.split("."))
    if value is _MISSING:
        raise _unusable("field", f"The message has no field {path}.")
    return value


def stamp_ms(stamp: Any, unit: str = "ns") -> int:
    """Return a ROS time, or a number in `unit`, as milliseconds. Raises FRAME_INVALID for what is no time."""
    if hasattr(stamp, "sec") and hasattr(stamp, "nanosec"):
        return int(stamp.sec) * 1000 + int(stamp.nanosec) // NS_PER_MS
    number = _number(stamp)
    if not math.isfinite(number) or not 0 <= number * TIME_UNITS_NS[unit] < 1 << 63:
        raise _unusable("time", "A time is no time.")
    exact = int(stamp) if isinstance(stamp, int) else number
    return int(exact * TIME_UNITS_NS[unit] // NS_PER_MS)


def header_ms(message: Any) -> int | None:
    """Return the stamp of a message's header, None if it has none or if it was never set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or not (stamp.sec or stamp.nanosec):
        return None
    return stamp_ms(stamp)


@dataclass(frozen=True, slots=True)
class TagMap:
    """Where a message holds the fields of a sighting; an empty path: it does not.

    `distance_sigma` may be a number instead of a path. `front` and `back` are the antennas, by number or name, that
    look as the camera looks and away from it; `facing` is a path to the word itself.
    """

    epc: str
    antenna: str = ""
    facing: str = ""
    front: tuple[str, ...] = ()
    back: tuple[str, ...] = ()
    rssi: str = ""
    rssi_unit: str = "dBm"
    distance: str = ""
    distance_sigma: str | float = ""
    distance_unit: str = "m"
    first_seen: str = ""
    last_seen: str = ""
    time_unit: str = "ns"
    read_count: str = ""

    @property
    def paths(self) -> tuple[str, ...]:
        """Every path of the map."""
        sigma = self.distance_sigma if isinstance(self.distance_sigma, str) else ""
        every = (self.epc, self.antenna, self.facing, self.rssi, self.distance, sigma, self.first_seen, self.last_seen)
        return tuple(path for path in (*every, self.read_count) if path)

    def read(
        self, message: Any, at_ms: int, shift_ms: int, received_at_ms: int, origin: str = ""
    ) -> tuple[list[Sighting], list[str]]:
        """Return the sightings of a message, and the reasons of those readings that make no sense.

        `at_ms` is when it was read if no field says so; `origin` is the topic. Raises FRAME_INVALID when the message as
        a whole is unusable.
        """
        columns = {path: read_path(message, path) for path in self.paths}
        lists = {len(values) for path, values in columns.items() if "[]" in path}
        if len(lists) > 1:
            raise _unusable("field", "The lists of a message with several readings are not of one length.")
        count = lists.pop() if lists else 1
        if count > READINGS_MAX_COUNT:
            raise _unusable("size", f"A message of {count} readings is too large.")
        sightings, reasons = [], []
        for index in range(count):
            row = {path: values[index] if "[]" in path else values for path, values in columns.items()}
            try:
                sightings.append(self._one(row, at_ms, shift_ms, received_at_ms, origin))
            except BlockRobotError as error:
                reasons.append(str(error.context.get("reason", "field")))
        return sightings, reasons

    def _one(self, row: dict[str, Any], at_ms: int, shift_ms: int, received_at_ms: int, origin: str) -> Sighting:
        last = stamp_ms(row[self.last_seen], self.time_unit) if self.last_seen else None
        first = stamp_ms(row[self.first_seen], self.time_unit) if self.first_seen else last
        first = at_ms if first is None else first
        last = first if last is None else last
        if not 0 <= last - first <= SEEN_MAX_MS:
            raise _unusable("time", "A reading ends before it begins, or lasts too long.")
        distance, sigma = self._distance(row)
        antenna = row[self.antenna] if self.antenna else 0
        return Sighting(
            first_seen_ms=first + shift_ms,
            last_seen_ms=last + shift_ms,
            uid=_uid(row[self.epc]),
            antenna=int(antenna) if isinstance(antenna, int | np.integer) else 0,
            facing=self._facing(row, antenna),
            rssi_dbm=_finite(row[self.rssi]) * RSSI_UNITS_DBM[self.rssi_unit] if self.rssi else 0.0,
            distance_m=distance,
            sigma_m=sigma,
            read_count=max(1, int(_finite(row[self.read_count]))) if self.read_count else 1,
            received_at_ms=received_at_ms,
            origin=origin,
        )

    def _distance(self, row: dict[str, Any]) -> tuple[float | None, float | None]:
        if not self.distance:
            return None, None
        unit = LENGTH_UNITS_M[self.distance_unit]
        distance = _number(row[self.distance]) * unit
        told = self.distance_sigma
        sigma = _number(row[told]) * unit if isinstance(told, str) else told * unit
        usable = math.isfinite(distance) and math.isfinite(sigma) and distance > 0 and sigma > 0
        return (distance, sigma) if usable else (None, None)

    def _facing(self, row: dict[str, Any], antenna: Any) -> Facing:
        if self.facing:
            word = str(row[self.facing])
            return Facing(word) if word in tuple(Facing) else Facing.UNKNOWN
        name = str(antenna)
        if self.antenna and name in self.front:
            return Facing.FRONT
        return Facing.BACK if self.antenna and name in self.back else Facing.UNKNOWN


def _walk(value: Any, parts: Sequence[str]) -> Any:
    for place, part in enumerate(parts):
        each = part.endswith("[]")
        value = getattr(value, part.removesuffix("[]"), _MISSING)
        if value is _MISSING:
            return _MISSING
        if each:
            if not isinstance(value, list | tuple | np.ndarray):
                return _MISSING
            rest = parts[place + 1 :]
            entries = value.tolist() if isinstance(value, np.ndarray) else list(value)
            found = [_walk(entry, rest) for entry in entries] if rest else entries
            return _MISSING if any(entry is _MISSING for entry in found) else found
    return value


def _uid(value: Any) -> str:
    """Return a tag's UID as text: text as it stands, bytes in hexadecimal, a number in decimal."""
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        value = value.tobytes()
    if isinstance(value, bytes | bytearray):
        text = bytes(value).hex().upper()
    elif isinstance(value, str | int | np.integer) and not isinstance(value, bool):
        text = str(value).strip()
    else:
        raise _unusable("field", "A tag's UID is neither text nor bytes nor a number.")
    if not 0 < len(text) <= EPC_MAX_CHARS or not text.isprintable():
        raise _unusable("tag", "A reading has no tag, or one that is too long.")
    return text


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise _unusable("field", "A field that should hold a number does not.")
    return float(value)


def _finite(value: Any) -> float:
    number = _number(value)
    return number if math.isfinite(number) else 0.0


def _unusable(reason: str, detail: str) -> BlockRobotError:
    return BlockRobotError("FRAME_INVALID", detail, reason=reason)
