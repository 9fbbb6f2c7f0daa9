"""A small real run of the benchmark of growth: real stores, contracts and proofs at sizes that are filled in no time."""

from __future__ import annotations

from pathlib import Path

from network.bench.growth.growth_bench import AXES, KINDS, GrowthOptions, run_growth_benchmark


async def test_every_operation_is_measured_at_each_size_and_a_second_run_fills_nothing(tmp_path: Path) -> None:
    sizes = dict.fromkeys(AXES, (10, 20))
    options = GrowthOptions(tmp_path / "growth", sizes)
    told: list[str] = []
    first = await run_growth_benchmark(options, told.append)
    assert {each.operation for each in first.figures.operations} == set(KINDS)
    for each in first.figures.operations:
        assert [size.size for size in each.sizes] == [10, 20], each.operation
        assert all(size.cpu_ms > 0 and size.wall_ms > 0 for size in each.sizes), each.operation
        assert each.exponent is not None
    assert first.ok == (not first.figures.missed)
    assert set(first.figures.filled_s) == {f"{name} {size}" for name in AXES for size in (10, 20)}
    for operation in ("snapshot", "scrub of all clips"):
        figures = next(each for each in first.figures.operations if each.operation == operation)
        assert all(size.told and size.peak_kib for size in figures.sizes), operation
    filled = {path: path.stat().st_ino for path in options.cache.iterdir()}
    await run_growth_benchmark(GrowthOptions(options.cache, {"visits": (10, 20), "state": (10,)}))
    assert {path: path.stat().st_ino for path in options.cache.iterdir()} == filled
    assert any("clips held: 20" in line for line in told)
