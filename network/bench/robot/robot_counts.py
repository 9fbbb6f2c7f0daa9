"""Holds what a robot says it kept against what owners found, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations

from clients.robot.run.event_log import BLOCKCHAIN_TRANSACTION, IMAGE_PAIRED, IMAGE_RETRIEVE, IMAGE_WITHHELD
from consensus.bounded_text import read_json_text


@dataclass(frozen=True, slots=True)
class Timed:
    """When a kept frame was decided, and when its record was final, in milliseconds of the robot's wall clock."""

    decided_at_ms: int
    final_at_ms: int

    @property
    def took_ms(self) -> int:
        """How long it took."""
        return self.final_at_ms - self.decided_at_ms


@dataclass(slots=True)
class LoggedFrames:
    """What a robot's own log says: of each alias, how often each frame was paired, kept, withheld; and how long it took.

    `taken_at_ms` is when each frame was taken up, in that order.
    """

    paired: dict[str, Counter[int]] = field(default_factory=dict)
    kept: dict[str, Counter[int]] = field(default_factory=dict)
    withheld: dict[str, Counter[int]] = field(default_factory=dict)
    times: list[Timed] = field(default_factory=list)
    taken_at_ms: list[int] = field(default_factory=list)

    @property
    def frames_per_s(self) -> float:
        """How many frames a second the robot took up, from the first to the last; 0 for fewer than two."""
        took_ms = self.taken_at_ms[-1] - self.taken_at_ms[0] if self.taken_at_ms else 0
        return 1000 * (len(self.taken_at_ms) - 1) / took_ms if took_ms > 0 else 0.0


def read_frames(lines: Iterable[str]) -> LoggedFrames:
    """Return what the lines of a robot's event log say of its frames."""
    found = LoggedFrames()
    counts = {IMAGE_PAIRED: found.paired, BLOCKCHAIN_TRANSACTION: found.kept, IMAGE_WITHHELD: found.withheld}
    for line in lines:
        row = read_json_text(line)
        if row["activity"] == IMAGE_RETRIEVE:
            found.taken_at_ms.append(row["time_ms"])
        if row["activity"] not in counts or not row["case"].startswith("frame-"):
            continue
        of_alias = counts[row["activity"]].setdefault(row["alias"], Counter())
        of_alias[int(row["case"].removeprefix("frame-"))] += 1
        if row["activity"] == BLOCKCHAIN_TRANSACTION and "detail" in row:
            found.times.append(Timed(row["detail"]["decided_at_ms"], row["time_ms"]))
    return found


@dataclass(frozen=True, slots=True)
class Reckoning:
    """Of one robot's frames, counted per frame and owner.

    `lost`: paired but neither kept nor withheld, or said to be kept and not found by its owner. `doubled`: found, kept
    or settled more than once. `unexplained`: found by an owner though the robot does not say that it kept it.
    """

    lost: int
    doubled: int
    unexplained: int


def reckon(logged: LoggedFrames, found: Sequence[Counter[int]]) -> Reckoning:
    """Compare a robot's log with what each owner found of that robot.

    The log's aliases are drawn anew for each run and name nobody: they are given to owners in the way in which most
    frames agree. That two owners were exchanged altogether cannot be seen here, but by what their pictures show.
    """
    unsettled = sum(
        (_set_of(frames) - _set_of(logged.kept.get(alias)) - _set_of(logged.withheld.get(alias))).total()
        for alias, frames in logged.paired.items()
    )
    settled = [
        logged.kept.get(alias, Counter[int]()) + logged.withheld.get(alias, Counter[int]())
        for alias in {*logged.kept, *logged.withheld}
    ]
    pairs = match_owners(logged.kept, found)
    missing = sum((_set_of(kept) - _set_of(has)).total() for kept, has in pairs)
    return Reckoning(
        lost=unsettled + missing,
        doubled=sum(_surplus(frames) for frames in [*settled, *found]),
        unexplained=sum((_set_of(has) - _set_of(kept)).total() for kept, has in pairs),
    )


def match_owners(
    kept: Mapping[str, Counter[int]], found: Sequence[Counter[int]]
) -> list[tuple[Counter[int], Counter[int]]]:
    """Return (kept, found) of each owner, in the way in which most frames agree; one without a partner has no frames.

    All ways are tried: for a handful of owners.
    """
    wide = max(len(kept), len(found))
    left = [*kept.values(), *(Counter[int]() for _ in range(wide - len(kept)))]
    right = [*found, *(Counter[int]() for _ in range(wide - len(found)))]
    ways = (list(zip(left, order, strict=True)) for order in permutations(right))
    return max(ways, key=lambda way: sum(len(one.keys() & other.keys()) for one, other in way))


def _set_of(frames: Counter[int] | None) -> Counter[int]:
    return Counter(dict.fromkeys(frames or (), 1))


def _surplus(frames: Counter[int]) -> int:
    return frames.total() - len(frames)


def untouched_by_cut(times: Sequence[Timed], cut_from_ms: int, caught_up_at_ms: int) -> list[Timed]:
    """Return the frames that were final before the cut, or decided after all that waited for its end was final."""
    return [time for time in times if time.final_at_ms < cut_from_ms or time.decided_at_ms > caught_up_at_ms]


def caught_up_at_ms(times: Sequence[Timed], cut_until_ms: int) -> int:
    """Return when the last frame that was decided before the end of the cut was final; its end if none waited."""
    waited = (time.final_at_ms for time in times if time.decided_at_ms <= cut_until_ms)
    return max([cut_until_ms, *waited])
