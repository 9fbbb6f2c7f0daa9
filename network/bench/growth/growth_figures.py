"""What a measurement of growth answers, and the exponent of a cost."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Literal

from msgspec import Struct

Kind = Literal["operation", "listing", "scan"]
"""An operation is no scan; a listing costs as much as it answers; a scan reads all there is."""

GOALS: Mapping[Kind, float] = {"operation": 0.15, "listing": 1.15, "scan": 1.15}
"""How fast the CPU time may grow, as a power of the size: an operation hardly, the others with what they read."""
HELD_MAX_BYTES = 32
"""How much more a scan may hold in memory for each item more: a mark, never the item."""
NOISE_MS = 0.3
"""What a cost may differ by between the sizes without counting as growth: below it the machine's noise decides."""


class SizeFigures(Struct, frozen=True, kw_only=True):
    """What one run cost at one size: medians; `peak_kib` is the most that a scan held in Python's memory."""

    size: int
    cpu_ms: float
    wall_ms: float
    runs: int
    peak_kib: float | None = None
    told: int | None = None


class OperationFigures(Struct, frozen=True, kw_only=True):
    """How an operation's cost grows with what is kept (`axis`).

    `exponent` (CPU) is judged, `wall_exponent` is with the disk's waits and the machine's other work; None: one size.
    `held_bytes`: what a scan holds in memory for each item more, between the two largest sizes at which it was watched.
    """

    operation: str
    axis: str
    kind: Kind
    sizes: list[SizeFigures]
    exponent: float | None
    wall_exponent: float | None
    held_bytes: float | None
    goal: float
    is_within_goal: bool


class GrowthFigures(Struct, frozen=True, kw_only=True):
    """`missed`: names of the operations that grow faster than they may."""

    operations: list[OperationFigures]
    missed: list[str]
    filled_s: dict[str, float]


def fit_exponent(points: Sequence[tuple[float, float]]) -> float | None:
    """Return the slope of log cost over log size (least squares); None without two sizes."""
    usable = [(math.log(size), math.log(cost)) for size, cost in points if size > 0 and cost > 0]
    if len({size for size, _ in usable}) < 2:
        return None
    return round(statistics.linear_regression(*zip(*usable, strict=True)).slope, 3)


def find_held_bytes(sizes: Sequence[SizeFigures]) -> float | None:
    """Return a scan's memory for each item more; the smaller size is beyond what it takes at once."""
    watched = [(each.size, each.peak_kib) for each in sizes if each.peak_kib is not None][-2:]
    if len(watched) < 2:
        return None
    (less, less_kib), (more, more_kib) = watched
    return round(1024 * (more_kib - less_kib) / (more - less), 1)


def judge(operation: str, axis: str, kind: Kind, sizes: Sequence[SizeFigures]) -> OperationFigures:
    exponent = fit_exponent([(each.size, each.cpu_ms) for each in sizes])
    held_bytes = find_held_bytes(sizes)
    is_noise = (
        max((each.cpu_ms for each in sizes), default=0) - min((each.cpu_ms for each in sizes), default=0) < NOISE_MS
    )
    grows = exponent is not None and exponent > GOALS[kind] and not is_noise
    return OperationFigures(
        operation=operation,
        axis=axis,
        kind=kind,
        sizes=list(sizes),
        exponent=exponent,
        wall_exponent=fit_exponent([(each.size, each.wall_ms) for each in sizes]),
        held_bytes=held_bytes,
        goal=GOALS[kind],
        is_within_goal=not grows and (held_bytes is None or held_bytes <= HELD_MAX_BYTES),
    )
