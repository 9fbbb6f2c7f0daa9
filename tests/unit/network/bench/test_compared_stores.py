"""Two stores side by side: how many times as long the other one takes, and when that misses the goal."""

from __future__ import annotations

from dataclasses import replace

import pytest
from click.testing import CliRunner
from msgspec.structs import replace as replace_figures

from network.bench.clips_apart import ClipsApart
from network.bench.conditions import Result
from network.bench.custody import custody_bench
from network.bench.custody.custody_bench import (
    ComparedFigures,
    CustodyFigures,
    CustodyOptions,
    compare_stores,
    run_custody_benchmark,
)
from network.cli.measure.bench_commands import bench


def figures(erase_ms: float, followed: float, catchup_s: float) -> CustodyFigures:
    return CustodyFigures(
        erase_p50_ms=erase_ms,
        erase_p95_ms=erase_ms,
        hook_records_per_s=followed,
        catchup_s=catchup_s,
        store_overhead=1.05,
        ciphertext_bytes=1_000,
        clips_lost=0,
        scan_records_per_s=30_000.0,
        hospital_day_scan_s=0.7,
        errors=0,
        error_codes={},
    )


def test_a_rate_counts_the_other_way_round_and_what_was_not_measured_is_missed() -> None:
    compared = compare_stores(figures(100, 9_000, 2), figures(250, 3_000, 8))
    erasing = {"erase_p50_ms": 2.5, "erase_p95_ms": 2.5}
    assert compared.times_slower == {**erasing, "hook_records_per_s": 3.0, "catchup_s": 4.0}
    assert compared.missed == ["catchup_s"]
    assert compared.machine_times_slower == 1.0
    strained = replace_figures(figures(250, 3_000, 8), scan_records_per_s=10_000.0)
    assert compare_stores(figures(100, 9_000, 2), strained).machine_times_slower == 3.0
    unmeasured = compare_stores(figures(100, 9_000, 2), figures(0.0, 9_000, 2))
    assert unmeasured.missed == ["erase_p50_ms", "erase_p95_ms"]


@pytest.mark.parametrize(("slow_s", "ok"), [(6.0, True), (6.1, False)])
async def test_both_stores_do_the_same_work_and_the_slower_one_decides(
    monkeypatch: pytest.MonkeyPatch, slow_s: float, ok: bool
) -> None:
    measured: list[CustodyOptions] = []

    async def run_one(options: CustodyOptions, _tell: object) -> Result[CustodyFigures]:
        measured.append(options)
        found = figures(100, 100, 2.0 if options.store == "sqlite" else slow_s)
        clips = options.apart.kind if options.apart else "store"
        conditions = {"store": options.store, "clips": clips, "load": 1.0}
        return Result(name="custody", ok=True, figures=found, conditions=conditions)

    monkeypatch.setattr(custody_bench, "_run_one", run_one)
    apart = ClipsApart("folder")
    result = await run_custody_benchmark(CustodyOptions(erasures=7, behind=90, beside="mongodb://there", apart=apart))
    assert isinstance(result.figures, ComparedFigures)
    assert result.ok == ok
    assert measured[1] == replace(measured[0], store="mongodb://there", apart=apart)
    assert measured[0].apart is None, "clips are kept apart by the second alone, so that this can be compared"
    assert (result.conditions["store"], result.conditions["beside_store"]) == ("sqlite", "mongodb://there")
    assert (result.conditions["clips"], result.conditions["beside_clips"]) == ("store", "folder")


def test_kept_clips_are_measured_without_another_store() -> None:
    done = CliRunner().invoke(bench, ["custody", "--held", "5", "--beside", "mongodb"])
    assert done.exit_code == 2
    assert "leave --store, --beside" in done.output
