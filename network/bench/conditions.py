"""Measurement conditions, and the common form of results."""

from __future__ import annotations

import math
import os
import platform
import statistics
from collections.abc import Sequence
from typing import Generic, TypeVar

from msgspec import Struct

F = TypeVar("F")
Condition = str | float | list[int] | dict[str, str] | None


class Result(Struct, Generic[F], kw_only=True):
    """What a measurement answers. What it was measured under differs from one to the other."""

    name: str
    ok: bool
    figures: F
    conditions: dict[str, Condition]


def measure_conditions(*, nodes: int, seed: int | None = None, **more: Condition) -> dict[str, Condition]:
    """Nodes, usable cores, 1-minute load at start, interpreter, seed and `more`."""
    return {
        "nodes": nodes,
        "cores": count_cores(),
        "load": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "seed": seed,
        **more,
    }


def count_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value not exceeded by `share` (0 to 1); 0.0 for none."""
    if not values:
        return 0.0
    ordered = sorted(values)
    return ordered[max(0, math.ceil(round(share * len(ordered), 6)) - 1)]


def latency_figures(values_ms: Sequence[float], shares: Sequence[int] = (50, 95, 99)) -> dict[str, float]:
    """`p50_ms` etc. and `mean_ms`."""
    figures = {f"p{share}_ms": round(percentile(values_ms, share / 100), 2) for share in shares}
    figures["mean_ms"] = round(statistics.fmean(values_ms), 2) if values_ms else 0.0
    return figures
