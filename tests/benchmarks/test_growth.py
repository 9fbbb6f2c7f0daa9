"""A small real run of the benchmark of growth: real stores, contracts and proofs at sizes that are filled in no time."""

from __future__ import annotations

from pathlib import Path

import pytest

from network.bench.growth import growth_figures
from network.bench.growth.growth_bench import AXES, KINDS, GrowthOptions, run_growth_benchmark


async def test_every_operation_is_measured_at_each_size_and_a_second_run_fills_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = dict.fromkeys(AXES, (10, 20))
    options = GrowthOptions(tmp_path / "growth", sizes)
    told: list[str] = []
    first = await run_growth_benchmark(options, told.append)
    assert {each.operation for each in first.figures.operations} == set(KINDS)
    for each in first.figures.operations:
        assert [size.size for size in each.sizes] == [10, 20], each.operation
        assert all(size.cpu_ms > 0 and size.wall_ms > 0 for size in each.sizes), each.operation
        assert each.exponent is not None
    assert set(first.figures.filled_s) == {f"{name} {size}" for name in AXES for size in (10, 20)}
    for operation in ("snapshot", "scrub of all clips"):
        figures = next(each for each in first.figures.operations if each.operation == operation)
        assert all(size.told and size.peak_kib for size in figures.sizes), operation
        assert figures.held_bytes is not None, operation
    filled = _files_in(options.cache)
    monkeypatch.setitem(growth_figures.GOALS, "listing", -10.0)
    monkeypatch.setattr(growth_figures, "NOISE_MS", -1.0)
    second = await run_growth_benchmark(GrowthOptions(options.cache, {"visits": (10, 20), "state": (10,)}))
    assert not second.ok, "nothing that lists gets so much cheaper"
    assert {"wallet records (visits)", "wallet audit (visits)"} <= set(second.figures.missed)
    assert _files_in(options.cache) == filled, "and nothing of what is kept is changed by measuring it"
    assert any("clips held: 20" in line for line in told)


def _files_in(cache: Path) -> dict[Path, tuple[int, int]]:
    found = {path: path.stat() for path in cache.rglob("*") if path.is_file()}
    return {path: (stat.st_ino, stat.st_mtime_ns) for path, stat in found.items()}
