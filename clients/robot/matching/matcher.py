"""Binds tags to tracks by likelihood over whole tracks, against rivals and an absent bearer.

Bind at log-odds 9.2, unbind below 0. No binding without informative distances, of a robot that drives more so, nor while an
unfollowed person at similar range may be the bearer. Bearings, where there are any, tell people apart who are as far away.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from clients.robot.matching.likelihood import BEARINGS, DISTANCES, Belief, Filters, FilterUpdate, log_antenna, log_sum
from clients.robot.matching.match_evidence import (
    BIND_LOG_ODDS,
    DISTANCE_LOG_ODDS_MIN,
    DRIVING_CUES_LOG_ODDS_MIN,
    READINGS_MIN_COUNT,
    RIVAL_WITHIN,
    MatchEvidence,
)
from clients.robot.matching.tracking import NEAREST_RANGE_MS, Track
from clients.robot.sensing.sensor_events import BEARING_SIGMA_MAX_DEG, Facing, Sighting, is_distance

PRIOR_ABSENT = 0.3
UNBIND_LOG_ODDS = 0.0
# Evidence older than this is let go, some seconds at a time, since what is left is then weighed again.
EVIDENCE_MS = 30_000
LET_GO_MS = 15_000
# Of all readings of one tag in a tenth of a second, one for each kind counts: a storm of readings weighs no more.
SLOT_MS = 100
TAGS_MAX_COUNT = 256
READINGS_MAX_COUNT = 2_048
AHEAD_MAX_MS = 60_000
SIGMA_MIN_M = 0.05
BEARING_SIGMA_MIN_DEG = 2.0
# Who is not followed and nearer than that in range to somebody who is could well be the bearer in their stead.
UNFOLLOWED_M = 1.5
_CHECKPOINT_EVERY_COUNT = 16

# A reader's delay is looked for among these shifts, for the report; it changes no verdict.
SHIFT_MAX_MS, SHIFT_STEP_MS = 4_000, 250
SHIFT_READINGS_MIN_COUNT, SHIFT_READINGS_MAX_COUNT = 8, 64
_SHIFT_BETTER = 0.4  # the spread that is left must be this small compared with the one without a shift
_SHIFT_SIGMAS = 2.5  # and no more than so many stated errors

_Order = tuple[int, int, int, str, int, float, float, float, float, float]


class _Evidence(NamedTuple):
    belief: Belief = DISTANCES.start
    compared: int = 0
    bearing_belief: Belief = BEARINGS.start
    bearings: int = 0
    bearing_ratio: float = 0.0
    front: int = 0
    back: int = 0
    distance_ratio: float = 0.0
    gap_m_sum: float = 0.0  # of distance minus camera range, over the distances compared
    gap_m2_sum: float = 0.0
    range_m_sum: float = 0.0
    sigma_m_sum: float = 0.0

    def ratio(self) -> float:
        return self.distance_ratio + self.bearing_ratio + log_antenna(self.front, self.back)

    def speaks(self, cues_min: float) -> bool:
        cues = self.distance_ratio + self.bearing_ratio
        return self.compared >= READINGS_MIN_COUNT and self.distance_ratio >= DISTANCE_LOG_ODDS_MIN and cues >= cues_min


_NOTHING = _Evidence()


class _TrackScore(NamedTuple):
    """A tag's evidence: all readings, and with everybody followed. `carried`: bound at another place, and those of this one
    do not speak for it by themselves yet.
    """

    every: _Evidence = _NOTHING
    sure: _Evidence = _NOTHING
    odds: float | None = None
    bound: bool = False
    carried: bool = False


_TrackScores = dict[int, _TrackScore]


class _UntrackedInterval(NamedTuple):
    """Interval (ms) with untracked people at ranges (m)."""

    after_ms: int
    until_ms: int
    ranges: tuple[float, ...]


@dataclass(slots=True)
class _Tag:
    readings: list[Sighting] = field(default_factory=list)
    heard_ms: int = 0
    has_distance: bool = False
    slots: dict[tuple[int, Facing, bool, bool], Sighting] = field(default_factory=dict)
    weighed: int = 0
    scores: _TrackScores = field(default_factory=dict)
    checkpoints: list[tuple[int, _TrackScores]] = field(default_factory=lambda: [(0, {})])
    known: bool = False  # whether the roster holds it
    # Up to here bindings stand as they were made, though the evidence is weighed again.
    decided_until_ms: int | None = None

    def add(self, sighting: Sighting) -> bool:
        at_ms = sighting.middle_ms
        measured = (sighting.distance_m is not None, sighting.bearing_deg is not None)
        slot = (at_ms // SLOT_MS, sighting.facing, *measured)
        present = self.slots.get(slot)
        if present is not None:
            if _order(present) <= _order(sighting):
                return False
            place = bisect_left(self.readings, _order(present), key=_order)
            del self.readings[place]
            self._rewind(place)
        elif len(self.readings) >= READINGS_MAX_COUNT:
            return False
        self.slots[slot] = sighting
        self.heard_ms = max(self.heard_ms, at_ms)
        self.has_distance |= sighting.distance_m is not None
        if not self.readings or at_ms > self.readings[-1].middle_ms:
            self.readings.append(sighting)
            return True
        place = bisect_left(self.readings, _order(sighting), key=_order)
        self.readings.insert(place, sighting)
        self._rewind(place)
        return True

    def _rewind(self, place: int) -> None:
        if place >= self.weighed:
            return
        while len(self.checkpoints) > 1 and self.checkpoints[-1][0] > place:
            self.checkpoints.pop()
        self.weighed, scores = self.checkpoints[-1]
        self.scores = dict(scores)

    def drop_before(self, first_ms: int) -> None:
        """Drop older readings; bindings stay until contradicted."""
        gone = bisect_left(self.readings, first_ms, key=lambda reading: reading.middle_ms)
        if gone == 0 or self.weighed < gone:
            return
        self.decided_until_ms = self.readings[self.weighed - 1].middle_ms
        del self.readings[:gone]
        self.slots = {slot: reading for slot, reading in self.slots.items() if reading.middle_ms >= first_ms}
        bound = {number: score for number, score in self.scores.items() if score.bound}
        self._begin_with({number: _TrackScore(bound=True, carried=score.carried) for number, score in bound.items()})

    def forget_evidence(self, contested: Container[int]) -> None:
        """Drop all readings. Bindings stay until contradicted, but for those to tracks that another tag may belong to; and
        so does that a tag may belong to a track.
        """
        if self.readings:
            self.decided_until_ms = self.readings[-1].middle_ms
        self.readings, self.slots = [], {}
        bound = {number: score.bound and number not in contested for number, score in self.scores.items()}
        self._begin_with(
            {
                number: _TrackScore(odds=score.odds, bound=bound[number], carried=bound[number])
                for number, score in self.scores.items()
                if bound[number] or (score.odds is not None and score.odds >= BIND_LOG_ODDS)
            }
        )

    def _begin_with(self, scores: _TrackScores) -> None:
        self.weighed, self.scores, self.checkpoints = 0, scores, [(0, dict(scores))]

    def forget_tracks(self, numbers: Sequence[int]) -> None:
        for scores in (self.scores, *(kept for _, kept in self.checkpoints)):
            for number in numbers:
                scores.pop(number, None)


class Matcher:
    """Each tag's readings by alias, and its bearer's track.

    Of a robot that `drives`, on better evidence: wherever it stops, the bearer may be beside its picture, as far away as
    somebody in it.
    """

    def __init__(self, *, drives: bool = False) -> None:
        self._drives = drives
        self._cues_min = DRIVING_CUES_LOG_ODDS_MIN if drives else -math.inf
        self._tags: dict[str, _Tag] = {}
        self._tracks: dict[int, Track] = {}
        self._waiting: set[str] = set()
        self._clouds: list[_UntrackedInterval] = []
        self._now_ms: int | None = None

    def note_unfollowed(self, at_ms: int, ranges: Sequence[float]) -> None:
        """Record ranges (m) of people not followed, or possibly hidden, in time order, before `advance` to that time.
        Readings beside them only count against binding people at similar range: the real bearer may lack a track.
        """
        # From the frame before, so that a reading between the two counts the same whether it comes in time or late.
        after_ms = at_ms - NEAREST_RANGE_MS if self._now_ms is None else min(self._now_ms, at_ms - 1)
        self._clouds.append(_UntrackedInterval(after_ms, at_ms + NEAREST_RANGE_MS, tuple(ranges)))

    def add_track(self, track: Track) -> None:
        self._tracks[track.number] = track

    def add_sighting(self, alias: str, sighting: Sighting, *, known: bool = True) -> None:
        """Add in any order, duplicates once; the next `advance` weighs it. Too old or a minute ahead of the camera:
        dropped. Not `known` (off the roster): evicted first.
        """
        now_ms = self._now_ms
        if now_ms is not None and not _first_kept_ms(now_ms) <= sighting.middle_ms <= now_ms + AHEAD_MAX_MS:
            return
        tag = self._tags.get(alias)
        if tag is None:
            if len(self._tags) >= TAGS_MAX_COUNT and not self._make_room(known=known):
                return
            tag = self._tags[alias] = _Tag()
        tag.known = tag.known or known
        if tag.add(_without_nonsense(sighting)):
            self._waiting.add(alias)

    def advance(self, at_ms: int) -> None:
        self._now_ms = at_ms = at_ms if self._now_ms is None else max(self._now_ms, at_ms)
        for alias in sorted(self._waiting):
            tag = self._tags[alias]
            self._weigh_until(tag, at_ms)
            tag.drop_before(_first_kept_ms(at_ms))
            self._weigh_until(tag, at_ms)
            if tag.weighed == len(tag.readings):
                self._waiting.discard(alias)

    def finish(self) -> None:
        for alias in sorted(self._waiting):
            tag = self._tags[alias]
            self._weigh_until(tag, tag.readings[-1].middle_ms)
        self._waiting.clear()

    def bound_track(self, alias: str, present: Sequence[int]) -> int | None:
        """None if none, several, or also another tag's."""
        mine = [number for number in present if self._is_bound(alias, number)]
        if len(mine) != 1:
            return None
        return None if self._is_contested(alias, mine[0]) else mine[0]

    def is_elsewhere(self, alias: str, at_ms: int) -> bool:
        """Whether the bearer is known but out of view."""
        mine = [track for number, track in self._tracks.items() if self._is_bound(alias, number)]
        return bool(mine) and not any(track.began_ms <= at_ms <= track.seen_ms for track in mine)

    def has_distance(self, alias: str) -> bool:
        tag = self._tags.get(alias)
        return tag is not None and tag.has_distance

    @property
    def held_count(self) -> int:
        return sum(len(tag.readings) for tag in self._tags.values())

    def log_odds(self, alias: str) -> dict[int, float]:
        tag = self._tags.get(alias)
        scores = tag.scores.items() if tag is not None else ()
        return {number: score.odds for number, score in scores if score.odds is not None}

    def explain(self, alias: str, present: Sequence[int]) -> MatchEvidence | None:
        """Best fit; None if never compared."""
        tag = self._tags.get(alias)
        if tag is None:
            return None
        stand = {number: tag.scores[number] for number in present if number in tag.scores}
        if not stand:
            return None
        ratio = {number: score.every.ratio() for number, score in stand.items()}
        best, *rivals = sorted(ratio, key=lambda number: -ratio[number])
        every = stand[best].every
        others = [ratio[number] for number in rivals]
        odds = _log_odds(ratio[best], others)
        rival = _log_odds(others[0], [ratio[best], *others[1:]]) if others else None
        compared = max(1, every.compared)
        return MatchEvidence(
            log_odds=odds,
            rival_log_odds=rival,
            distances=every.compared,
            gap_m=every.gap_m_sum / compared,
            sigma_m=every.sigma_m_sum / compared,
            front=every.front,
            back=every.back,
            people=len(present),
            distance_log_odds=every.distance_ratio,
            bearings=every.bearings,
            bearing_log_odds=every.bearing_ratio,
            cues_log_odds_min=self._cues_min,
            is_contested=self._is_contested(alias, best),
            spread_m=math.sqrt(max(0.0, every.gap_m2_sum / compared - (every.gap_m_sum / compared) ** 2)),
            range_m=every.range_m_sum / compared,
            delay_ms=_find_delay_ms(tag.readings, self._tracks[best]) if odds < 0 and best in self._tracks else None,
        )

    def forget_before(self, at_ms: int) -> None:
        horizon = at_ms - EVIDENCE_MS
        del self._clouds[: bisect_left(self._clouds, horizon - LET_GO_MS, key=lambda cloud: cloud.until_ms)]
        gone = [n for n, track in self._tracks.items() if track.seen_ms < horizon]
        for number in gone:
            del self._tracks[number]
        for alias, tag in list(self._tags.items()):
            tag.forget_tracks(gone)
            if tag.heard_ms < horizon:
                self._drop(alias)

    def forget_evidence(self) -> None:
        """Weigh what comes from now on by itself; bindings stay until contradicted, but for those that are contested."""
        contested = {
            alias: [number for number, score in tag.scores.items() if score.bound and self._is_contested(alias, number)]
            for alias, tag in self._tags.items()
        }
        for alias, tag in self._tags.items():
            tag.forget_evidence(contested[alias])
        self._waiting.clear()

    def _is_bound(self, alias: str, number: int) -> bool:
        tag = self._tags.get(alias)
        score = tag.scores.get(number) if tag is not None else None
        return score is not None and score.bound

    def _is_contested(self, alias: str, number: int) -> bool:
        """Whether another tag may be that of the track to which this one is bound."""
        return any(self._may_be(other, alias, number) for other in self._tags if other != alias)

    def _may_be(self, other: str, alias: str, number: int) -> bool:
        if self._is_bound(other, number):
            return True
        rival, mine = (self._tags[each].scores.get(number, _TrackScore()).odds for each in (other, alias))
        if not self._drives or rival is None:
            return False
        fits = rival >= max(BIND_LOG_ODDS, (BIND_LOG_ODDS if mine is None else mine) - RIVAL_WITHIN)
        return fits and not self._is_seen_elsewhere(other, number)

    def _is_seen_elsewhere(self, alias: str, number: int) -> bool:
        """Whether its bearer is another who was seen at the same time."""
        track = self._tracks.get(number)
        return track is not None and any(
            seen is not track and seen.overlaps(track) and self._is_bound(alias, seen.number)
            for seen in self._tracks.values()
        )

    def _make_room(self, *, known: bool) -> bool:
        """Evict the longest-silent stranger's tag, or for a roster tag a roster one; its owner is withheld, never shown."""
        order = {alias: (tag.known, tag.heard_ms, alias) for alias, tag in self._tags.items()}
        oldest = min(order, key=lambda alias: order[alias])
        if self._tags[oldest].known and not known:
            return False
        self._drop(oldest)
        return True

    def _drop(self, alias: str) -> None:
        del self._tags[alias]
        self._waiting.discard(alias)

    def _weigh_until(self, tag: _Tag, at_ms: int) -> None:
        while tag.weighed < len(tag.readings) and tag.readings[tag.weighed].middle_ms <= at_ms:
            self._weigh(tag, tag.readings[tag.weighed])
            tag.weighed += 1
            if tag.weighed - tag.checkpoints[-1][0] >= _CHECKPOINT_EVERY_COUNT:
                tag.checkpoints.append((tag.weighed, dict(tag.scores)))

    def _weigh(self, tag: _Tag, reading: Sighting) -> None:
        at_ms = reading.middle_ms
        clouds = self._ranges_unfollowed(at_ms)
        steps: dict[int, FilterUpdate] = {}
        for number, track in self._tracks.items():
            place = track.place_at(at_ms)
            if place is None:
                continue
            person_m, _ = place
            old = tag.scores.get(number) or _TrackScore()
            every = _update_evidence(old.every, reading, at_ms, place, steps)
            sure = old.sure
            if all(abs(person_m - unfollowed_m) > UNFOLLOWED_M for unfollowed_m in clouds):
                # As long as nobody was ever in doubt, the two are one.
                sure = every if sure is old.every else _update_evidence(sure, reading, at_ms, place, steps)
            tag.scores[number] = old._replace(every=every, sure=sure)
        self._decide(tag, at_ms)

    def _ranges_unfollowed(self, at_ms: int) -> list[float]:
        place = bisect_left(self._clouds, at_ms, key=lambda cloud: cloud.until_ms)
        found: list[float] = []
        while place < len(self._clouds) and self._clouds[place].after_ms < at_ms:
            found += self._clouds[place].ranges
            place += 1
        return found

    def _decide(self, tag: _Tag, at_ms: int) -> None:
        tracks = [track for track in self._tracks.values() if track.began_ms <= at_ms and track.number in tag.scores]
        every = {track.number: tag.scores[track.number].every.ratio() for track in tracks}
        sure = {track.number: tag.scores[track.number].sure.ratio() for track in tracks}
        for track in tracks:
            score = tag.scores[track.number]
            if score.every.compared < READINGS_MIN_COUNT:
                continue
            rivals = [o.number for o in tracks if o.number != track.number and o.overlaps(track)]
            odds = _log_odds(every[track.number], [every[number] for number in rivals])
            bound, carried = score.bound, score.carried
            if tag.decided_until_ms is None or at_ms > tag.decided_until_ms:
                speaks = score.every.speaks(self._cues_min)
                carried = score.carried and not speaks
                bound = bound and odds >= UNBIND_LOG_ODDS and (speaks or carried or not self._drives)
                if odds >= BIND_LOG_ODDS and speaks and score.sure.speaks(self._cues_min):
                    surely = _log_odds(sure[track.number], [sure[number] for number in rivals])
                    bound = bound or surely >= BIND_LOG_ODDS
            tag.scores[track.number] = score._replace(odds=odds, bound=bound, carried=carried)


def _update_evidence(
    evidence: _Evidence, reading: Sighting, at_ms: int, place: tuple[float, float], steps: dict[int, FilterUpdate]
) -> _Evidence:
    person_m, person_deg = place
    if reading.distance_m is not None and reading.sigma_m is not None:
        evidence = _compare(evidence, at_ms, reading.distance_m, reading.sigma_m, person_m, steps)
    if reading.bearing_deg is not None and reading.bearing_sigma_deg is not None:
        measured = (reading.bearing_deg, reading.bearing_sigma_deg)
        belief, ratio = _weigh_one(BEARINGS, evidence.bearing_belief, at_ms, measured, person_deg, steps)
        evidence = evidence._replace(bearing_belief=belief, bearing_ratio=ratio, bearings=evidence.bearings + 1)
    front, back = reading.facing is Facing.FRONT, reading.facing is Facing.BACK
    return evidence._replace(front=evidence.front + front, back=evidence.back + back)


def _compare(
    evidence: _Evidence, at_ms: int, distance_m: float, sigma_m: float, person_m: float, steps: dict[int, FilterUpdate]
) -> _Evidence:
    belief, ratio = _weigh_one(DISTANCES, evidence.belief, at_ms, (distance_m, sigma_m), person_m, steps)
    return evidence._replace(
        belief=belief,
        compared=evidence.compared + 1,
        distance_ratio=ratio,
        gap_m_sum=evidence.gap_m_sum + distance_m - person_m,
        gap_m2_sum=evidence.gap_m2_sum + (distance_m - person_m) ** 2,
        range_m_sum=evidence.range_m_sum + person_m,
        sigma_m_sum=evidence.sigma_m_sum + sigma_m,
    )


def _weigh_one(
    filters: Filters,
    belief: Belief,
    at_ms: int,
    measured: tuple[float, float],
    of_person: float,
    steps: dict[int, FilterUpdate],
) -> tuple[Belief, float]:
    """`measured`: value and standard deviation. Return the belief and the log likelihood ratio, worn to absent."""
    value, sigma = measured
    step = steps.get(id(belief.spread))
    if step is None:
        step = steps[id(belief.spread)] = filters.step(belief.spread, at_ms, sigma)
    belief = filters.update(belief, step, value, of_person)
    visible, absent = filters.log_evidence(belief)
    return belief, visible - absent


def _log_odds(ratio: float, rivals: Sequence[float]) -> float:
    share = math.log((1 - PRIOR_ABSENT) / (1 + len(rivals)))
    return share + ratio - log_sum([math.log(PRIOR_ABSENT), *(share + rival for rival in rivals)])


def _first_kept_ms(now_ms: int) -> int:
    return (now_ms - EVIDENCE_MS) // LET_GO_MS * LET_GO_MS


def _order(reading: Sighting) -> _Order:
    distance_m, sigma_m = reading.distance_m or 0.0, reading.sigma_m or 0.0
    bearing_deg, bearing_sigma_deg = reading.bearing_deg or 0.0, reading.bearing_sigma_deg or 0.0
    facing, rssi = str(reading.facing), reading.rssi_dbm
    return (
        reading.middle_ms,
        reading.first_seen_ms,
        reading.antenna,
        facing,
        reading.read_count,
        distance_m,
        sigma_m,
        rssi,
        bearing_deg,
        bearing_sigma_deg,
    )


def _without_nonsense(sighting: Sighting) -> Sighting:
    distance_m, sigma_m = sighting.distance_m, sighting.sigma_m
    if distance_m is None or sigma_m is None or not is_distance(distance_m, sigma_m):
        distance_m = sigma_m = None
    else:
        sigma_m = max(sigma_m, SIGMA_MIN_M)
    bearing_deg, bearing_sigma_deg = sighting.bearing_deg, sighting.bearing_sigma_deg
    if bearing_deg is None or bearing_sigma_deg is None or not _is_bearing(bearing_deg, bearing_sigma_deg):
        bearing_deg = bearing_sigma_deg = None
    else:
        bearing_sigma_deg = max(bearing_sigma_deg, BEARING_SIGMA_MIN_DEG)
    usable = (distance_m, sigma_m, bearing_deg, bearing_sigma_deg)
    if usable == (sighting.distance_m, sighting.sigma_m, sighting.bearing_deg, sighting.bearing_sigma_deg):
        return sighting
    return replace(
        sighting, distance_m=distance_m, sigma_m=sigma_m, bearing_deg=bearing_deg, bearing_sigma_deg=bearing_sigma_deg
    )


def _is_bearing(bearing_deg: float, sigma_deg: float) -> bool:
    return -180 <= bearing_deg <= 180 and 0 < sigma_deg <= BEARING_SIGMA_MAX_DEG


def _find_delay_ms(readings: Sequence[Sighting], track: Track) -> int | None:
    """Return how far distances lag behind the track, None if no shift helps; reported only."""
    measured = [reading for reading in readings if reading.distance_m is not None][-SHIFT_READINGS_MAX_COUNT:]
    if len(measured) < SHIFT_READINGS_MIN_COUNT or not track.times:
        return None
    at_ms = np.array([reading.middle_ms for reading in measured], dtype=np.float64)
    distances = np.array([reading.distance_m for reading in measured], dtype=np.float64)
    sigma_m = float(np.mean([reading.sigma_m or 0.0 for reading in measured]))
    times, ranges = np.array(track.times, dtype=np.float64), np.array(track.ranges)
    found = {}
    for shift_ms in sorted(range(-SHIFT_MAX_MS, SHIFT_MAX_MS + 1, SHIFT_STEP_MS), key=abs):
        then_ms = at_ms - shift_ms
        inside = (then_ms >= times[0]) & (then_ms <= times[-1])
        if np.count_nonzero(inside) >= max(SHIFT_READINGS_MIN_COUNT, len(measured) // 2):
            gaps = distances[inside] - np.interp(then_ms[inside], times, ranges)
            found[shift_ms] = float(np.sqrt(np.mean(gaps * gaps)))
    if 0 not in found:
        return None
    best_ms = min(found, key=lambda shift_ms: found[shift_ms])
    is_better = found[best_ms] <= min(_SHIFT_BETTER * found[0], _SHIFT_SIGMAS * sigma_m)
    return best_ms if best_ms and is_better else None
