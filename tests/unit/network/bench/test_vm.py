"""The benchmark of the contract machine measures the real contract, and fails loudly where that refuses."""

from __future__ import annotations

import pytest

from contracts.execution.registry import load_contracts
from network.bench.vm import OWNER, RecordBench, run_vm_benchmark


def test_a_short_run_gives_all_figures_and_conditions() -> None:
    result = run_vm_benchmark(0.02)
    assert (result["name"], result["ok"]) == ("vm", True)
    assert all(result["figures"][name] > 0 for name in ("record_calls_per_s", "compile_ms", "gas_per_s", "record_gas"))
    assert {"nodes", "cores", "load", "python", "host_calls_per_record"} <= set(result["conditions"])


def test_each_call_stores_one_record_of_the_visit() -> None:
    bench = RecordBench(load_contracts())
    for _ in range(3):
        bench.record()
    assert sum(key.startswith(b"records\x00record/") for key in bench.host.entries) == 3
    assert sum(key.startswith(b"records\x00of-visit/" + OWNER) for key in bench.host.entries) == 3


def test_a_refused_call_is_no_measurement() -> None:
    bench = RecordBench(load_contracts())
    with pytest.raises(RuntimeError, match="VISIT_UNKNOWN"):
        bench.invoke("close_visit", [b"\x03" + b"x" * 32, 0])
