"""Reads sightings, labels and sound from any message type, by field paths.

`.` separates fields, `[]` means each entry, `{}` JSON text: `epc = "ids[]"`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np

from clients.robot.sensing.sensor_events import BEARING_SIGMA_MAX_DEG, NS_PER_MS, Facing, Sighting, is_distance
from clients.robot.sources.messages.image_decoding import refuse
from consensus.errors import BlockRobotError

EPC_MAX_CHARS = 64
READINGS_MAX_COUNT = 16_384
"""The most readings that one message may hold."""

SEEN_MAX_MS = 60_000
"""The longest time over which one reading may say that its tag was seen; pairing remembers no longer."""

JSON_MAX_CHARS = 256 * 1024
"""The longest JSON text that is read out of one field."""
JSON_DEPTH_MAX_COUNT = 6
"""How deep in a JSON text fields are looked for when a topics file is drafted."""

TIME_UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
LENGTH_UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
ANGLE_UNITS_DEG = {"deg": 1.0, "rad": 180 / math.pi}
RSSI_UNITS_DBM = {"dBm": 1.0, "cdBm": 0.01}

_FIELD = r"[A-Za-z_][A-Za-z0-9_]*(\{\})?(\[\])?"
_PATH = re.compile(rf"{_FIELD}(\.{_FIELD})*")
_PART = re.compile(r"(?P<name>[^{\[]*)(?P<json>\{\})?(?P<each>\[\])?")
_MISSING = object()
_FACING_WORDS = frozenset({Facing.FRONT.value, Facing.BACK.value})


def check_path(path: str, name: str) -> str:
    """Return a valid `path`. Raises TOPICS_INVALID naming the setting."""
    if not _PATH.fullmatch(path) or path.count("[]") > 1 or path.count("{}") > 1:
        raise BlockRobotError(
            "TOPICS_INVALID",
            f"{name} = {path!r} is no path of fields, as tag.epc, ids[] or data{{}}.uid (at most one [] and one {{}}).",
        )
    return path


def read_path(message: Any, path: str) -> Any:
    """Return the value at a path, a list for `[]`. Raises FRAME_INVALID (`field`, `json`)."""
    value = _walk(message, path.split("."))
    if value is _MISSING:
        raise refuse("field", f"The message has no field {path}.")
    return value


def json_paths(message: Any, field: str) -> list[str]:
    """Return value paths in a field's JSON, by first list entries."""
    try:
        document = _parse_json(getattr(message, field, None))
    except BlockRobotError:
        return []
    return [path for path in _paths_in(document, f"{field}{{}}", JSON_DEPTH_MAX_COUNT) if _PATH.fullmatch(path)]


def _paths_in(value: Any, path: str, deeper_count: int) -> Iterator[str]:
    if isinstance(value, dict) and deeper_count:
        for name, entry in value.items():
            yield from _paths_in(entry, f"{path}.{name}", deeper_count - 1)
    elif isinstance(value, list) and value and "[]" not in path and deeper_count:
        yield from _paths_in(value[0], f"{path}[]", deeper_count - 1)
    elif isinstance(value, str | int | float):
        yield path


def stamp_ms(stamp: Any, unit: str = "ns") -> int:
    """In ms. Raises FRAME_INVALID."""
    if hasattr(stamp, "sec") and hasattr(stamp, "nanosec"):
        return int(stamp.sec) * 1000 + int(stamp.nanosec) // NS_PER_MS
    number = _number(stamp)
    if not math.isfinite(number) or not 0 <= number * TIME_UNITS_NS[unit] < 1 << 63:
        raise refuse("time", "A time is no time.")
    exact = int(stamp) if isinstance(stamp, int) else number
    return int(exact * TIME_UNITS_NS[unit] // NS_PER_MS)


def header_ms(message: Any) -> int | None:
    """In ms; None if absent or unset."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or not (stamp.sec or stamp.nanosec):
        return None
    return stamp_ms(stamp)


@dataclass(frozen=True, slots=True)
class TagMap:
    """Paths of a sighting's fields; empty: absent.

    `distance_sigma`, `bearing_sigma`: number or path; `bearing_positive`: `left` (REP 103) or `right`; `front`, `back`:
    antennas by number or name; `facing`: a path, or a fixed `front`
    or `back`.
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
    bearing: str = ""
    bearing_sigma: str | float = ""
    bearing_unit: str = "deg"
    bearing_positive: str = "left"
    first_seen: str = ""
    last_seen: str = ""
    time_unit: str = "ns"
    read_count: str = ""

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(self.named_paths.values())

    @property
    def named_paths(self) -> dict[str, str]:
        every = {
            "epc": self.epc,
            "antenna": self.antenna,
            "facing": "" if self.facing in _FACING_WORDS else self.facing,
            "rssi": self.rssi,
            "distance": self.distance,
            "distance_sigma": self.distance_sigma if isinstance(self.distance_sigma, str) else "",
            "bearing": self.bearing,
            "bearing_sigma": self.bearing_sigma if isinstance(self.bearing_sigma, str) else "",
            "first_seen": self.first_seen,
            "last_seen": self.last_seen,
            "read_count": self.read_count,
        }
        return {key: path for key, path in every.items() if path}

    def antennas_of(self, message: Any) -> list[Any]:
        value = read_path(message, self.antenna) if self.antenna else []
        return value if "[]" in self.antenna else [value] if self.antenna else []

    def unnamed_antenna(self, antenna: Any) -> str:
        """Return an antenna missing from given `front` and `back`, else ""."""
        name = str(antenna)
        named = (*self.front, *self.back)
        return name if self.antenna and named and name not in named else ""

    @property
    def knows_facing(self) -> bool:
        return bool(self.facing or self.front or self.back)

    def read(
        self, message: Any, at_ms: int, shift_ms: int, received_at_ms: int, origin: str = ""
    ) -> tuple[list[Sighting], list[str]]:
        """Return sightings and invalid readings' reasons; `at_ms`: default time, `origin`: topic. Raises FRAME_INVALID."""
        columns = {path: read_path(message, path) for path in self.paths}
        lists = {len(values) for path, values in columns.items() if "[]" in path}
        if len(lists) > 1:
            raise refuse("field", "The lists of a message with several readings are not of one length.")
        count = lists.pop() if lists else 1
        if count > READINGS_MAX_COUNT:
            raise refuse("size", f"A message of {count} readings is too large.")
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
            raise refuse("time", "A reading ends before it begins, or lasts too long.")
        distance, sigma = self._distance(row)
        bearing, bearing_sigma = self._bearing(row)
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
            bearing_deg=bearing,
            bearing_sigma_deg=bearing_sigma,
            read_count=max(1, int(_finite(row[self.read_count]))) if self.read_count else 1,
            received_at_ms=received_at_ms,
            origin=origin,
        )

    def _distance(self, row: dict[str, Any]) -> tuple[float | None, float | None]:
        if not self.distance:
            return None, None
        unit = LENGTH_UNITS_M[self.distance_unit]
        distance = _number(row[self.distance]) * unit
        value = self.distance_sigma
        sigma = _number(row[value]) * unit if isinstance(value, str) else value * unit
        return (distance, sigma) if is_distance(distance, sigma) else (None, None)

    def _bearing(self, row: dict[str, Any]) -> tuple[float | None, float | None]:
        if not self.bearing:
            return None, None
        unit = ANGLE_UNITS_DEG[self.bearing_unit]
        bearing = _number(row[self.bearing]) * (unit if self.bearing_positive == "right" else -unit)
        value = self.bearing_sigma
        sigma = (_number(row[value]) if isinstance(value, str) else value) * unit
        usable = math.isfinite(bearing) and 0 < sigma <= BEARING_SIGMA_MAX_DEG
        return ((bearing + 180) % 360 - 180, sigma) if usable else (None, None)

    def _facing(self, row: dict[str, Any], antenna: Any) -> Facing:
        if self.facing:
            word = self.facing if self.facing in _FACING_WORDS else str(row[self.facing])
            return Facing(word) if word in tuple(Facing) else Facing.UNKNOWN
        name = str(antenna)
        if self.antenna and name in self.front:
            return Facing.FRONT
        return Facing.BACK if self.antenna and name in self.back else Facing.UNKNOWN


def _walk(value: Any, parts: Sequence[str]) -> Any:
    for place, part in enumerate(parts):
        step = _PART.fullmatch(part)
        assert step is not None, "a path was not checked"
        name = step["name"]
        value = value.get(name, _MISSING) if isinstance(value, dict) else getattr(value, name, _MISSING)
        if value is _MISSING:
            return _MISSING
        if step["json"]:
            value = _parse_json(value)
        if step["each"]:
            if not isinstance(value, list | tuple | np.ndarray):
                return _MISSING
            rest = parts[place + 1 :]
            entries = value.tolist() if isinstance(value, np.ndarray) else list(value)
            found = [_walk(entry, rest) for entry in entries] if rest else entries
            return _MISSING if any(entry is _MISSING for entry in found) else found
    return value


def _parse_json(text: Any) -> Any:
    """Raises FRAME_INVALID."""
    if not isinstance(text, str) or len(text) > JSON_MAX_CHARS:
        raise refuse("json", f"A field that should hold JSON is not text of at most {JSON_MAX_CHARS} characters.")
    return _parsed_json(text)


@lru_cache(maxsize=4)  # each path of a map asks for the same text again
def _parsed_json(text: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        raise refuse("json", "A field that should hold JSON does not.") from None


def _uid(value: Any) -> str:
    """Bytes in hexadecimal, numbers in decimal."""
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        value = value.tobytes()
    if isinstance(value, bytes | bytearray):
        text = bytes(value).hex().upper()
    elif isinstance(value, str | int | np.integer) and not isinstance(value, bool):
        text = str(value).strip()
    else:
        raise refuse("field", "A tag's UID is neither text nor bytes nor a number.")
    if text.startswith(("{", "[")):
        raise refuse("json", "The tag's UID stands in JSON text: name its field, as in data{}.uid.")
    if not 0 < len(text) <= EPC_MAX_CHARS or not text.isprintable():
        raise refuse("tag", "A reading has no tag, or one that is too long.")
    return text


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise refuse("field", "A field that should hold a number does not.")
    return float(value)


def _finite(value: Any) -> float:
    number = _number(value)
    return number if math.isfinite(number) else 0.0
