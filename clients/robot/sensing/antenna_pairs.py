"""A tag's bearing from two antennas that look to different sides: the nearer to an antenna's axis, the louder.

Between two antennas the difference in dB grows evenly with the bearing where both beams are alike (amplitude comparison
monopulse); what a tag, a body or the distance does to both falls out. `robot antennas calibrate` measures the line.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from clients.robot.sensing.sensor_events import BEARING_SIGMA_MAX_DEG, RSSI_UNKNOWN_DBM, Sighting

PAIRED_WITHIN_MS = 300
BEARING_MAX_DEG = 90.0  # beyond it the line says only that the tag is far to that side
# Two pairs that disagree by more than this many standard deviations hear reflections: neither is believed.
DISAGREE_SIGMAS = 3.0
REMEMBERED_MAX_COUNT = 16  # readings of one tag by one antenna
ANTENNAS_MAX_COUNT = 32  # of one tag
TAGS_MAX_COUNT = 256


@dataclass(frozen=True, slots=True)
class AntennaPair:
    """RSSI of `right` minus `left` is `offset_db + slope_db_per_deg * bearing`, give or take `sigma_db`.

    `reader`: the topic, or the address, whose antennas these are; empty: every reader's.
    """

    left: int
    right: int
    offset_db: float
    slope_db_per_deg: float
    sigma_db: float
    reader: str = ""

    @property
    def sigma_deg(self) -> float:
        return self.sigma_db / self.slope_db_per_deg

    def bearing_deg(self, left_dbm: float, right_dbm: float) -> float:
        bearing_deg = (right_dbm - left_dbm - self.offset_db) / self.slope_db_per_deg
        return max(-BEARING_MAX_DEG, min(BEARING_MAX_DEG, bearing_deg))

    def is_usable(self) -> bool:
        return self.left != self.right and self.slope_db_per_deg > 0 and 0 < self.sigma_deg <= BEARING_SIGMA_MAX_DEG


@dataclass(slots=True, eq=False)
class _Heard:
    at_ms: int
    rssi_dbm: float
    used: bool = False  # each reading makes one bearing: errors of several would be one error


_HeardByAntenna = dict[tuple[str, int], deque[_Heard]]


class AntennaBearings:
    """Adds bearings to the readings of a run, in the order in which they come."""

    def __init__(self, pairs: Sequence[AntennaPair]) -> None:
        self._pairs = sorted(pairs, key=lambda pair: pair.sigma_deg)
        self._tags: OrderedDict[str, _HeardByAntenna] = OrderedDict()

    def restart(self) -> None:
        """Readings that follow have another clock."""
        self._tags.clear()

    def locate(self, alias: str, sighting: Sighting) -> Sighting:
        """Return the sighting with a bearing, if it has none and another antenna heard the tag at that time."""
        if not self._pairs or sighting.bearing_deg is not None or sighting.rssi_dbm == RSSI_UNKNOWN_DBM:
            return sighting
        antennas = self._tags.setdefault(alias, {})
        self._tags.move_to_end(alias)
        if len(self._tags) > TAGS_MAX_COUNT:
            self._tags.popitem(last=False)
        mine = _Heard(sighting.middle_ms, sighting.rssi_dbm)
        place = (sighting.origin, sighting.antenna)
        found = [one for pair in self._pairs for one in _pair_up(antennas, pair, place, mine)]
        if place in antennas or len(antennas) < ANTENNAS_MAX_COUNT:
            antennas.setdefault(place, deque(maxlen=REMEMBERED_MAX_COUNT)).append(mine)
        if not found:
            return sighting
        best, other, bearing_deg = found[0]
        if any(_disagree(best, bearing_deg, pair, other_deg) for pair, _, other_deg in found[1:]):
            return sighting
        mine.used = other.used = True
        return replace(sighting, bearing_deg=bearing_deg, bearing_sigma_deg=best.sigma_deg)


def _pair_up(
    antennas: _HeardByAntenna, pair: AntennaPair, place: tuple[str, int], mine: _Heard
) -> Iterator[tuple[AntennaPair, _Heard, float]]:
    """Yield the bearing by the other antenna's nearest reading in time, if there is one."""
    origin, antenna = place
    if antenna not in (pair.left, pair.right) or pair.reader not in ("", origin):
        return
    there = antennas.get((origin, pair.right if antenna == pair.left else pair.left), ())
    near = [one for one in there if not one.used and abs(one.at_ms - mine.at_ms) <= PAIRED_WITHIN_MS]
    if near:
        other = min(near, key=lambda one: abs(one.at_ms - mine.at_ms))
        left, right = (mine, other) if antenna == pair.left else (other, mine)
        yield pair, other, pair.bearing_deg(left.rssi_dbm, right.rssi_dbm)


def _disagree(pair: AntennaPair, bearing_deg: float, other: AntennaPair, other_deg: float) -> bool:
    sigma_deg = math.hypot(pair.sigma_deg, other.sigma_deg)
    return abs(bearing_deg - other_deg) > DISAGREE_SIGMAS * sigma_deg
