"""Measures device clocks against the host's from the streams.

Lower edge of (received - stamp): a line of offset and drift; the shortest delay stays in it. Offsets are measured only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, TypeVar

from clients.robot.sensing.sensor_events import Event, Frame, Odometry, Sighting
from clients.sdk.terminal.json_answers import Answer, Count, MsFloat, doc

DELAY_MAX_MS = 2_000  # between stamp and receipt; what does not fit in is a clock that was set, or a wrong stamp
LATE_MAX_MS = 60_000  # unless the stamp goes on from the one before: then the host was busy, at most so long
LATE_FOR_MS = 10_000  # and catches up within this time
CONFIRM_COUNT = 5  # as many doubtful stamps in a row, all agreeing, and the clock was set
BIN_MS = 5_000
HORIZON_MS = 600_000  # what is older says nothing of today's drift; so many bins at most are kept
DRIFT_MAX_PPM = 500.0  # quartz is within 100
DRIFT_SPAN_MIN_MS = 60_000
STEP_MIN_MS = 50.0  # smaller steps of a clock are taken for delay
STEP_BINS_COUNT = 3
READERS_MAX_COUNT = 32  # more than a robot can be configured with
READING_MAX_MS = 10_000  # of a longer reading its end counts: some readers tell when they saw a tag first of all
_PPM = 1e-6
_Kind = TypeVar("_Kind", bound=Event)


class DeviceClock(Answer, frozen=True, kw_only=True):
    """What was found of a device's clock."""

    offset_ms: Annotated[MsFloat, doc("Host time minus device time")]
    drift_ppm: Annotated[float, doc("How fast that grows, in millionths")]
    uncertainty_ms: Annotated[MsFloat, doc("How far it may be off")]
    sample_count: Annotated[Count, doc("From how many timestamps")]
    started_anew_count: Annotated[Count, doc("How often the clock was found to be set")]


class TimestampStatus(StrEnum):
    """A stamp's relation to the line so far."""

    FITS = "fits"
    DOUBTFUL = "doubtful"
    CLOCK_SET = "clock-set"


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Host minus device time at a moment, drift, and uncertainty."""

    offset_ms: float
    drift_ppm: float
    uncertainty_ms: float
    sample_count: int
    started_anew_count: int

    def summarise(self) -> DeviceClock:
        return DeviceClock(
            offset_ms=round(self.offset_ms, 1),
            drift_ppm=round(self.drift_ppm, 1),
            uncertainty_ms=round(self.uncertainty_ms, 1),
            sample_count=self.sample_count,
            started_anew_count=self.started_anew_count,
        )


@dataclass(slots=True)
class _Bin:
    """A few seconds' lowest point and number of points."""

    at: float
    low: float
    count: int = 1


class ClockEstimator:
    """One device's clock; one point per bin within the horizon.

    Restarts after `CONFIRM_COUNT` agreeing doubtful stamps, `STEP_BINS_COUNT` bins far above, or a horizon's silence.
    `LATE_FOR_MS` allows host lag.
    """

    def __init__(self) -> None:
        self._origin: tuple[int, int] = (0, 0)
        self._bins: dict[int, _Bin] = {}
        self._newest_bin = 0
        self._level = 0.0
        self._slope = 0.0
        self._spread = 0.0
        self._drift_doubt = DRIFT_MAX_PPM * _PPM
        self._samples = 0
        self._doubts: list[tuple[int, int]] = []
        self._newest_stamp = 0
        self._late_since: int | None = None
        self.started_anew_count = 0

    def observe(self, stamp_ms: int, received_ms: int) -> TimestampStatus:
        if not self._bins:
            self._start(stamp_ms, received_ms)
            return TimestampStatus.FITS
        at = received_ms - self._origin[0]
        if abs(at // BIN_MS - self._newest_bin) >= HORIZON_MS // BIN_MS:
            self._start_anew(stamp_ms, received_ms)
            return TimestampStatus.FITS
        above = received_ms - stamp_ms - self._origin[1] - self._line(at)
        if above > DELAY_MAX_MS and self._is_catching_up(above, stamp_ms, received_ms):
            self._newest_stamp = stamp_ms
            self._doubts.clear()
            return TimestampStatus.FITS
        if abs(above) > DELAY_MAX_MS:
            return self._doubt(stamp_ms, received_ms)
        if above < -_tolerance(self._uncertainty(at)):
            return self._doubt(stamp_ms, received_ms)
        self._doubts.clear()
        self._late_since = None
        self._newest_stamp = max(stamp_ms, self._newest_stamp)
        self._take(at, received_ms - stamp_ms - self._origin[1])
        return TimestampStatus.FITS

    def offset_at(self, received_ms: int) -> float | None:
        """Host minus device time (ms), None before the first stamp."""
        if not self._bins:
            return None
        return self._origin[1] + self._line(received_ms - self._origin[0])

    def estimate(self, received_ms: int) -> ClockEstimate | None:
        """None before the first stamp."""
        offset = self.offset_at(received_ms)
        if offset is None:
            return None
        uncertainty = self._uncertainty(received_ms - self._origin[0])
        return ClockEstimate(offset, self._slope / _PPM, uncertainty, self._samples, self.started_anew_count)

    def _is_catching_up(self, above_ms: float, stamp_ms: int, received_ms: int) -> bool:
        goes_on = 0 <= stamp_ms - self._newest_stamp <= DELAY_MAX_MS
        if not goes_on or above_ms > LATE_MAX_MS:
            return False
        if self._late_since is None:
            self._late_since = received_ms
        return 0 <= received_ms - self._late_since <= LATE_FOR_MS

    def _start(self, stamp_ms: int, received_ms: int) -> None:
        self._origin = (received_ms, received_ms - stamp_ms)
        self._bins = {0: _Bin(0.0, 0.0)}
        self._newest_bin = 0
        self._level = self._slope = self._spread = 0.0
        self._drift_doubt = DRIFT_MAX_PPM * _PPM
        self._samples = 1
        self._newest_stamp, self._late_since = stamp_ms, None
        self._doubts.clear()

    def _start_anew(self, stamp_ms: int, received_ms: int) -> None:
        self.started_anew_count += 1
        self._start(stamp_ms, received_ms)

    def _doubt(self, stamp_ms: int, received_ms: int) -> TimestampStatus:
        delay = received_ms - stamp_ms
        if any(abs(delay - (other[1] - other[0])) > DELAY_MAX_MS for other in self._doubts):
            self._doubts.clear()
        self._doubts.append((stamp_ms, received_ms))
        if len(self._doubts) < CONFIRM_COUNT:
            return TimestampStatus.DOUBTFUL
        agreed = list(self._doubts)
        self._start_anew(*agreed[0])
        for stamp, received in agreed[1:]:
            self._newest_stamp = max(stamp, self._newest_stamp)
            self._take(received - self._origin[0], received - stamp - self._origin[1])
        return TimestampStatus.CLOCK_SET

    def _take(self, at: float, low: float) -> None:
        number = int(at // BIN_MS)
        self._samples += 1
        kept = self._bins.get(number)
        if kept is not None:
            kept.count += 1
            if low - self._slope * at < kept.low - self._slope * kept.at:
                kept.at, kept.low = at, low
                self._fit()
            return
        if number > self._newest_bin:
            self._drop_a_lone_stamp_ahead()
            self._drop_what_is_before_a_step()
        self._newest_bin = max(number, self._newest_bin)
        self._bins[number] = _Bin(at, low)
        for old in [n for n in self._bins if n <= self._newest_bin - HORIZON_MS // BIN_MS]:
            self._samples -= self._bins.pop(old).count
        self._fit()

    def _drop_a_lone_stamp_ahead(self) -> None:
        """If all other bins are far above, the lowest is a wrong stamp."""
        lowest = min(self._bins, key=lambda number: self._bins[number].low - self._line(self._bins[number].at))
        if lowest not in sorted(self._bins)[:-STEP_BINS_COUNT]:
            return
        others = [one for number, one in sorted(self._bins.items()) if number != lowest]
        span = others[-1].at - others[0].at
        slope = _middle_slope([(one.at, one.low) for one in others]) if span >= DRIFT_SPAN_MIN_MS else 0.0
        slope = max(-DRIFT_MAX_PPM * _PPM, min(DRIFT_MAX_PPM * _PPM, slope))
        level = min(one.low - slope * one.at for one in others)
        spread = sum(one.low - slope * one.at - level for one in others) / len(others)
        count = sum(one.count for one in others)
        lone = self._bins[lowest]
        if level + slope * lone.at - lone.low > _tolerance(1 + spread + DELAY_MAX_MS / (count + 1)):
            self._samples -= self._bins.pop(lowest).count
            self._fit()

    def _drop_what_is_before_a_step(self) -> None:
        """Several bins far above the line: a clock set back."""
        order = sorted(self._bins)
        older, recent = order[:-STEP_BINS_COUNT], order[-STEP_BINS_COUNT:]
        if not older:
            return
        above = {number: one.low - self._line(one.at) for number, one in self._bins.items()}
        count = sum(self._bins[number].count for number in older)
        doubt = 1 + sum(above[number] for number in older) / len(older) + DELAY_MAX_MS / (count + 1)
        if min(above[number] for number in recent) > _tolerance(doubt):
            self._bins = {number: self._bins[number] for number in recent}
            self._samples -= count
            self._slope = 0.0
            self.started_anew_count += 1

    def _fit(self) -> None:
        """Fit the lower hull's edge below the points' middle."""
        points = [(one.at, one.low) for _, one in sorted(self._bins.items())]
        span = points[-1][0] - points[0][0]
        if span >= DRIFT_SPAN_MIN_MS:
            limit = DRIFT_MAX_PPM * _PPM
            self._slope = max(-limit, min(limit, _middle_slope(points)))
        self._level = min(low - self._slope * at for at, low in points)
        self._spread = sum(low - self._line(at) for at, low in points) / len(points)
        if span >= DRIFT_SPAN_MIN_MS:
            self._drift_doubt = min(DRIFT_MAX_PPM * _PPM, 2 * (self._spread + 1) / span)

    def _line(self, at: float) -> float:
        return self._level + self._slope * at

    def _uncertainty(self, at: float) -> float:
        """In ms: stamp rounding, scatter, delay spread, drift."""
        middle = (min(self._bins) + max(self._bins) + 1) * BIN_MS / 2
        return 1 + self._spread + DELAY_MAX_MS / (self._samples + 1) + self._drift_doubt * abs(at - middle)


def _tolerance(uncertainty_ms: float) -> float:
    return STEP_MIN_MS + 5 * uncertainty_ms


def _middle_slope(points: list[tuple[float, float]]) -> float:
    """The lower hull's, at mean time; points in time order, at least two."""
    hull: list[tuple[float, float]] = []
    for at, low in points:
        while len(hull) > 1 and (hull[-1][0] - hull[-2][0]) * (low - hull[-2][1]) <= (hull[-1][1] - hull[-2][1]) * (
            at - hull[-2][0]
        ):
            hull.pop()
        hull.append((at, low))
    middle = sum(at for at, _ in points) / len(points)
    right = next((i for i, (at, _) in enumerate(hull) if at >= middle and i), len(hull) - 1)
    (x0, y0), (x1, y1) = hull[right - 1], hull[right]
    return (y1 - y0) / (x1 - x0)


@dataclass(slots=True)
class _Reader:
    clock: ClockEstimator = field(default_factory=ClockEstimator)
    held: list[Sighting] = field(default_factory=list)


class RunClocks:
    """Clocks of camera and at most `READERS_MAX_COUNT` sighting origins.

    Moves sightings to camera time; doubtful events wait (`CONFIRM_COUNT` per stream), then pass or count in `refused`.
    Without receipt time, stamps are trusted.
    """

    def __init__(self) -> None:
        self.camera = ClockEstimator()
        self.odometry = ClockEstimator()
        self.refused = {"frame-time": 0, "sighting-time": 0, "odometry-time": 0}
        self.shortened_count = 0
        self.newest_ms: int | None = None
        self._held_frames: list[Frame] = []
        self._held_odometry: list[Odometry] = []
        self._readers: dict[str, _Reader] = {}  # the one heard last stands last

    def admit(self, event: Event) -> list[Event]:
        """In receipt order; return events released."""
        if event.received_at_ms is not None:
            self.newest_ms = event.received_at_ms
        if isinstance(event, Frame):
            return list(self._admit_frame(event))
        if isinstance(event, Odometry):
            return list(self._admit_odometry(event))
        return list(self._admit_sighting(event))

    def flush(self) -> None:
        """Refuse doubtful events, at the end of input."""
        self.refused["frame-time"] += len(self._held_frames)
        self._held_frames.clear()
        self.refused["odometry-time"] += len(self._held_odometry)
        self._held_odometry.clear()
        for reader in self._readers.values():
            self._refuse_held(reader)

    @property
    def camera_offset_ms(self) -> int:
        """Host clock minus camera clock, 0 while unknown."""
        return round(self.camera.offset_at(self.newest_ms or 0) or 0.0)

    def estimates(self) -> dict[str, ClockEstimate]:
        """By `camera`, `reader ORIGIN` and `odometry`."""
        at = self.newest_ms if self.newest_ms is not None else 0
        found = {f"reader {origin}".rstrip(): one.clock.estimate(at) for origin, one in sorted(self._readers.items())}
        found |= {"camera": self.camera.estimate(at), "odometry": self.odometry.estimate(at)}
        return {name: estimate for name, estimate in found.items() if estimate is not None}

    def _admit_frame(self, frame: Frame) -> list[Frame]:
        if frame.received_at_ms is None:
            return [frame]
        status = self.camera.observe(frame.captured_at_ms, frame.received_at_ms)
        return self._sort(frame, status, self._held_frames, "frame-time")

    def _admit_odometry(self, place: Odometry) -> list[Odometry]:
        if place.received_at_ms is None:
            return [place]
        status = self.odometry.observe(place.at_ms, place.received_at_ms)
        released = self._sort(place, status, self._held_odometry, "odometry-time")
        to_camera = -round(self.camera.offset_at(place.received_at_ms) or 0.0)
        shift_ms = round(self.odometry.offset_at(place.received_at_ms) or 0.0) + to_camera
        return [replace(one, at_ms=one.at_ms + shift_ms) for one in released]

    def _admit_sighting(self, sighting: Sighting) -> list[Sighting]:
        lasting_ms = sighting.last_seen_ms - sighting.first_seen_ms
        if lasting_ms < 0:
            self.refused["sighting-time"] += 1
            return []
        if lasting_ms > READING_MAX_MS:
            self.shortened_count += 1
            sighting = replace(sighting, first_seen_ms=sighting.last_seen_ms - READING_MAX_MS)
        if sighting.received_at_ms is None:
            return [sighting]
        reader = self._reader_of(sighting.origin)
        status = reader.clock.observe(sighting.last_seen_ms, sighting.received_at_ms)
        return [self._move(one, reader.clock) for one in self._sort(sighting, status, reader.held, "sighting-time")]

    def _reader_of(self, origin: str) -> _Reader:
        """Evicts the longest silent one."""
        reader = self._readers.pop(origin, None) or _Reader()
        if len(self._readers) >= READERS_MAX_COUNT:
            self._refuse_held(self._readers.pop(next(iter(self._readers))))
        self._readers[origin] = reader
        return reader

    def _refuse_held(self, reader: _Reader) -> None:
        self.refused["sighting-time"] += len(reader.held)
        reader.held.clear()

    def _sort(self, event: _Kind, status: TimestampStatus, held: list[_Kind], name: str) -> list[_Kind]:
        if status is TimestampStatus.DOUBTFUL:
            held.append(event)
            if len(held) >= CONFIRM_COUNT:  # doubts that do not agree with one another
                held.pop(0)
                self.refused[name] += 1
            return []
        waited = list(held)
        held.clear()
        if status is TimestampStatus.CLOCK_SET:
            return [*waited, event]
        self.refused[name] += len(waited)
        return [event]

    def _move(self, sighting: Sighting, clock: ClockEstimator) -> Sighting:
        received_ms = sighting.received_at_ms or 0
        to_camera = -round(self.camera.offset_at(received_ms) or 0.0)
        shift = round(clock.offset_at(received_ms) or 0.0) + to_camera
        return replace(
            sighting,
            first_seen_ms=sighting.first_seen_ms + shift,
            last_seen_ms=sighting.last_seen_ms + shift,
            received_at_ms=received_ms + to_camera,
        )
