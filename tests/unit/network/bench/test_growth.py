"""Growth: the exponent, what is judged by it, which sizes are measured, and that each is filled once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from network.bench.growth import growth_bench
from network.bench.growth.growth_bench import AXES, choose_sizes, fill_once
from network.bench.growth.growth_figures import (
    GOALS,
    NOISE_MS,
    Kind,
    OperationFigures,
    SizeFigures,
    fit_exponent,
    judge,
)
from network.bench.growth.growth_timing import (
    PEAK_SIZE_MAX_COUNT,
    RUNS_COUNT,
    WARM_UP_COUNT,
    Spent,
    time_operation,
    time_scan,
)
from network.cli.measure.bench_commands import GROWTH_AXES
from node.custody import erase_keys
from node.custody.stores import sqlite_schema
from node.storage import lmdb_layout

SIZES = (1_000, 10_000, 100_000)


@pytest.mark.parametrize("power", [0.0, 0.15, 0.5, 1.0, 2.0])
def test_the_exponent_of_a_power_is_found(power: float) -> None:
    assert fit_exponent([(size, 3 * size**power) for size in SIZES]) == pytest.approx(power, abs=0.001)


def test_one_size_has_no_exponent_and_nothing_measured_has_none() -> None:
    assert fit_exponent([(1_000, 5.0)]) is None
    assert fit_exponent([(1_000, 5.0), (1_000, 6.0)]) is None
    assert fit_exponent([(1_000, 0.0), (10_000, 0.0)]) is None


def judged(
    kind: Kind, costs_ms: tuple[float, ...], peaks_kib: tuple[float | None, ...] = (None,) * 3
) -> OperationFigures:
    sizes = [
        SizeFigures(size=size, cpu_ms=cost, wall_ms=2 * cost, runs=3, peak_kib=peak)
        for size, cost, peak in zip(SIZES, costs_ms, peaks_kib, strict=True)
    ]
    return judge("something", "clips", kind, sizes)


def test_an_operation_may_hardly_grow_and_a_scan_with_what_it_reads() -> None:
    assert judged("operation", (10, 11, 12)).is_within_goal
    assert not judged("operation", (10, 20, 40)).is_within_goal
    assert judged("scan", (10, 100, 1_000)).is_within_goal
    assert judged("listing", (10, 100, 1_000)).is_within_goal
    assert not judged("scan", (10, 200, 4_000)).is_within_goal
    assert judged("operation", (10, 20, 40)).goal == GOALS["operation"]


def test_a_scan_that_holds_what_it_reads_misses_its_goal() -> None:
    a_mark_each, an_item_each = (5_000.0, 5_100.0, 6_000.0), (5_000.0, 10_000.0, 100_000.0)
    assert judged("scan", (10, 100, 1_000), a_mark_each).is_within_goal
    missed = judged("scan", (10, 100, 1_000), an_item_each)
    assert (missed.held_bytes, missed.is_within_goal) == (1024.0, False)
    assert judged("scan", (10, 100, 1_000), (5_000.0, None, None)).held_bytes is None


def test_differences_below_the_machines_noise_are_no_growth() -> None:
    step = NOISE_MS / 4
    assert judged("operation", (step, 2 * step, 4 * step)).is_within_goal
    assert not judged("operation", (step, 4 * step, 16 * step)).is_within_goal


def test_full_sizes_go_on_where_the_default_ones_end() -> None:
    usual, full = choose_sizes((), is_full=False), choose_sizes((), is_full=True)
    assert tuple(AXES) == GROWTH_AXES == tuple(usual) == tuple(full)
    for name, sizes in usual.items():
        assert 2 <= len(sizes) < len(full[name])
        assert full[name][: len(sizes)] == sizes == tuple(sorted(sizes))
    assert choose_sizes(("clips",), is_full=False) == {"clips": usual["clips"]}


@pytest.mark.parametrize("axis", ["clips", "state"])
def test_what_scans_hold_is_watched_at_two_default_sizes(axis: str) -> None:
    assert len([size for size in choose_sizes((axis,), is_full=False)[axis] if size <= PEAK_SIZE_MAX_COUNT]) >= 2


async def test_a_size_is_filled_once_and_anew_after_a_filling_that_was_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fillings: list[int] = []

    async def fill(folder: Path, size: int, _on_progress: object) -> None:
        assert not (folder / "half").exists(), "what a filling left that was cut off is gone"
        (folder / "half").write_text("")
        fillings.append(size)
        if len(fillings) == 1:
            raise KeyboardInterrupt
        (folder / "whole").write_text("")

    monkeypatch.setattr(growth_bench, "AXES", {"clips": replace(AXES["clips"], fill=fill)})
    with pytest.raises(KeyboardInterrupt):
        await fill_once(tmp_path, "clips", 10, print)
    first, _ = await fill_once(tmp_path, "clips", 10, print)
    second, filled_s = await fill_once(tmp_path, "clips", 10, print)
    other, _ = await fill_once(tmp_path, "clips", 20, print)
    for module, name, format_name in (
        (sqlite_schema, "FORMAT_VERSION", 999),
        (erase_keys, "FORMAT_VERSION", 999),
        (lmdb_layout, "FORMAT_NAME", b"blockrobot-ledger/999"),
    ):
        monkeypatch.setattr(module, name, format_name)
        await fill_once(tmp_path, "clips", 20, print)
    assert fillings == [10, 10, 20, 20, 20, 20], "each format is filled anew"
    assert first == second != other
    assert (first / "whole").is_file()
    assert filled_s == 0.0


async def test_warming_up_does_not_count_and_only_the_timed_part_does() -> None:
    runs = 0

    async def run(spent: Spent) -> None:
        nonlocal runs
        runs += 1
        with spent.once():
            pass

    figures = await time_operation(7, run)
    assert (figures.size, figures.runs, runs) == (7, RUNS_COUNT, RUNS_COUNT + WARM_UP_COUNT)


async def test_of_a_scan_is_said_what_it_held_and_how_often_it_told_how_far_it_is() -> None:
    async def scan(tell: object) -> None:
        held = bytearray(1_000_000)
        assert callable(tell)
        for _ in range(len(held) // 250_000):
            tell()

    figures = await time_scan(7, scan)
    assert figures.told == 4
    assert figures.peak_kib is not None
    assert 970 < figures.peak_kib < 2_000
    assert (await time_scan(7, scan, is_watched=False)).peak_kib is None
