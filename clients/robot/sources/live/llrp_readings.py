"""One LLRP reader's reports as sightings without distance, in host time.

Each reader has its own clock: UTC or uptime.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Facing, RefusedMessage, Sighting
from clients.robot.sources.messages.field_map import EPC_MAX_CHARS
from clients.robot.sources.messages.topics import LlrpReader

GATHER_MS = 100
"""For so long readings of one tag by one antenna are gathered into one sighting."""

GATHERED_MAX_COUNT = 4_096
EPC_WORD_BITS = 16
STAMP_MAX_US = 1 << 62
_KIND = "sighting"
_US_PER_MS = 1_000


class LlrpReadings:
    """One reader's readings, at most `GATHERED_MAX_COUNT` between flushes."""

    def __init__(self, reader: LlrpReader) -> None:
        self._reader = reader
        self._clocks = RunClocks()
        self._gathered: dict[tuple[str, int], Sighting] = {}

    def convert_report(self, report: Any, received_ms: int) -> list[Sighting | RefusedMessage]:
        """Return completed sightings or refusals of a TagReportData."""
        uid = _uid(report)
        if uid is None:
            return [RefusedMessage(received_ms, _KIND, "tag")]
        reading = self._reading(uid, report, received_ms)
        if reading is None:
            return [RefusedMessage(received_ms, _KIND, "time")]
        place = (uid, reading.antenna)
        before = self._gathered.get(place)
        if before is None:
            done = self.flush() if len(self._gathered) >= GATHERED_MAX_COUNT else []
            self._gathered[place] = reading
            return done
        if abs(reading.last_seen_ms - before.last_seen_ms) > GATHER_MS:
            self._gathered[place] = reading
            return self._put_on_our_clock(before)
        self._gathered[place] = _joined(before, reading)
        return []

    def flush(self) -> list[Sighting | RefusedMessage]:
        """Ordered by last heard."""
        gathered = sorted(self._gathered.values(), key=lambda one: one.received_at_ms or 0)
        self._gathered.clear()
        return [made for one in gathered for made in self._put_on_our_clock(one)]

    def _put_on_our_clock(self, reading: Sighting) -> list[Sighting | RefusedMessage]:
        refused_before = sum(self._clocks.refused.values())
        made: list[Sighting | RefusedMessage] = [
            one for one in self._clocks.admit(reading) if isinstance(one, Sighting)
        ]
        refused = sum(self._clocks.refused.values()) - refused_before
        return [*made, *[RefusedMessage(reading.received_at_ms or 0, _KIND, "time")] * refused]

    def _reading(self, uid: str, report: Any, received_ms: int) -> Sighting | None:
        last = _stamp_ms(report.last_seen_timestamp_utc, report.last_seen_timestamp_uptime)
        first = _stamp_ms(report.first_seen_timestamp_utc, report.first_seen_timestamp_uptime)
        last = first if last is None else last
        first = last if first is None else first
        if last is None or first is None:  # it tells no time at all: then it was just now
            first = last = received_ms
        if not 0 <= first <= last < STAMP_MAX_US // _US_PER_MS:
            return None
        antenna = report.antenna_id.antenna_id if report.antenna_id is not None else 0
        return Sighting(
            first_seen_ms=first,
            last_seen_ms=last,
            uid=uid,
            antenna=antenna,
            facing=self._facing(antenna),
            rssi_dbm=float(report.peak_rssi.peak_rssi) if report.peak_rssi is not None else 0.0,
            read_count=max(1, report.tag_seen_count.tag_count) if report.tag_seen_count is not None else 1,
            received_at_ms=received_ms,
            origin=self._reader.address,
        )

    def _facing(self, antenna: int) -> Facing:
        if antenna in self._reader.front:
            return Facing.FRONT
        return Facing.BACK if antenna in self._reader.back else Facing.UNKNOWN


def _uid(report: Any) -> str | None:
    """An EPC in upper-case hexadecimal, None if invalid."""
    given = report.epc_parameter.epc
    bits = getattr(given, "bit_len", None)
    data = bytes(given if bits is None else given.data)
    if bits is None:
        bits = 8 * len(data)
    text = data.hex().upper()
    return text if 0 < len(text) <= EPC_MAX_CHARS and bits % EPC_WORD_BITS == 0 else None


def _stamp_ms(*given: Any) -> int | None:
    return next((int(stamp.microseconds) // _US_PER_MS for stamp in given if stamp is not None), None)


def _joined(before: Sighting, reading: Sighting) -> Sighting:
    return replace(
        before,
        first_seen_ms=min(before.first_seen_ms, reading.first_seen_ms),
        last_seen_ms=max(before.last_seen_ms, reading.last_seen_ms),
        rssi_dbm=max(before.rssi_dbm, reading.rssi_dbm),
        read_count=before.read_count + reading.read_count,
        received_at_ms=reading.received_at_ms,
    )
