"""Compares a robot's kept frames with those that owners found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations

from clients.robot.recording.event_log import BLOCKCHAIN_TRANSACTION, IMAGE_PAIRED, IMAGE_RETRIEVE, IMAGE_WITHHELD
from consensus.bounded_text import read_json_text


@dataclass(frozen=True, slots=True)
class Timed:
    """A kept frame's decision and its record's finality, robot wall clock ms."""

    decided_at_ms: int
    final_at_ms: int

    @property
    def took_ms(self) -> int:
        return self.final_at_ms - self.decided_at_ms


@dataclass(slots=True)
class LoggedFrames:
    """A robot log: per alias how often each frame was paired, kept, withheld; durations.

    `taken_at_ms` lists frame start times in order.
    """

    paired: dict[str, Counter[int]] = field(default_factory=dict)
    kept: dict[str, Counter[int]] = field(default_factory=dict)
    withheld: dict[str, Counter[int]] = field(default_factory=dict)
    times: list[Timed] = field(default_factory=list)
    taken_at_ms: list[int] = field(default_factory=list)

    @property
    def frames_per_s(self) -> float:
        took_ms = self.taken_at_ms[-1] - self.taken_at_ms[0] if self.taken_at_ms else 0
        return 1000 * (len(self.taken_at_ms) - 1) / took_ms if took_ms > 0 else 0.0


def read_frames(lines: Iterable[str]) -> LoggedFrames:
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
class FrameAccount:
    """One robot's frame counts per frame and owner.

    `lost`: paired but neither kept nor withheld, or kept but not found; `doubled`: found, kept or settled twice;
    `unexplained`: found but not kept.
    """

    lost: int
    doubled: int
    unexplained: int


def account_for_frames(logged: LoggedFrames, found: Sequence[Counter[int]]) -> FrameAccount:
    """Aliases, random per run, are matched to owners by most common frames; exchanged owners show only in the pictures."""
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
    return FrameAccount(
        lost=unsettled + missing,
        doubled=sum(_surplus(frames) for frames in [*settled, *found]),
        unexplained=sum((_set_of(has) - _set_of(kept)).total() for kept, has in pairs),
    )


def match_owners(
    kept: Mapping[str, Counter[int]], found: Sequence[Counter[int]]
) -> list[tuple[Counter[int], Counter[int]]]:
    """(kept, found) per owner by best total match; tries all permutations."""
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
    """Final before the cut or decided after the catch-up."""
    return [time for time in times if time.final_at_ms < cut_from_ms or time.decided_at_ms > caught_up_at_ms]


def caught_up_at_ms(times: Sequence[Timed], cut_until_ms: int) -> int:
    """When the last frame decided before the cut's end became final, else its end."""
    waited = (time.final_at_ms for time in times if time.decided_at_ms <= cut_until_ms)
    return max([cut_until_ms, *waited])
