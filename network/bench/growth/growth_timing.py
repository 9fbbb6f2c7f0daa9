"""Times one operation again and again, and a scan once more for what it holds in memory."""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from network.bench.growth.growth_figures import SizeFigures

RUNS_COUNT = 15
WARM_UP_COUNT = 3
SCANS_COUNT = 3
SCAN_ENOUGH_S = 5.0
PEAK_SIZE_MAX_COUNT = 100_000
"""Above it what a scan holds is not measured: watching each allocation makes it several times as slow."""


Tell = Callable[[], None]


@dataclass(slots=True)
class Spent:
    """CPU time of all threads, and time by the clock, of each run."""

    cpu_ms: list[float] = field(default_factory=list)
    wall_ms: list[float] = field(default_factory=list)

    @contextmanager
    def once(self) -> Iterator[None]:
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        yield
        self.cpu_ms.append(1000 * (time.process_time() - cpu_s))
        self.wall_ms.append(1000 * (time.perf_counter() - wall_s))

    def summarise(self, size: int, peak_kib: float | None = None, told: int | None = None) -> SizeFigures:
        return SizeFigures(
            size=size,
            cpu_ms=round(statistics.median(self.cpu_ms), 4),
            wall_ms=round(statistics.median(self.wall_ms), 4),
            runs=len(self.cpu_ms),
            peak_kib=peak_kib,
            told=told,
        )


async def time_operation(size: int, run: Callable[[Spent], Awaitable[None]]) -> SizeFigures:
    """`run` times what belongs to the operation of what it does."""
    spent = Spent()
    for _ in range(WARM_UP_COUNT):
        await run(Spent())
    for _ in range(RUNS_COUNT):
        await run(spent)
    return spent.summarise(size)


async def time_scan(size: int, scan: Callable[[Tell], Awaitable[None]], *, is_watched: bool = True) -> SizeFigures:
    """`scan` calls back wherever it tells how far it is; `is_watched`: for what it holds in memory."""
    told, spent = 0, Spent()

    def tell() -> None:
        nonlocal told
        told += 1

    while len(spent.wall_ms) < SCANS_COUNT and sum(spent.wall_ms) < 1000 * SCAN_ENOUGH_S:
        told = 0
        with spent.once():
            await scan(tell)
    counted, peak_kib = told, None
    if is_watched and size <= PEAK_SIZE_MAX_COUNT:
        tracemalloc.start()
        try:
            await scan(tell)
            peak_kib = round(tracemalloc.get_traced_memory()[1] / 1024, 1)
        finally:
            tracemalloc.stop()
    return spent.summarise(size, peak_kib, counted)
