"""The benchmark of the contract machine measures the real contract, and fails loudly where that refuses."""

from __future__ import annotations

import sys

import pytest

from consensus.limits import BLOCK_GAS_MAX, BLOCK_TRANSACTIONS_MAX_COUNT
from contracts.lifecycle.registry import load_contracts
from network.bench.vm.vm_bench import OWNER, MemoryHost, RecordBench, group_of, run_vm_benchmark
from network.bench.vm.vm_blocks import BlockBench


def test_a_short_run_gives_all_figures_and_conditions() -> None:
    result = run_vm_benchmark(0.01, profile=True)
    assert (result.name, result.ok) == ("vm", True)
    named = ("record_calls_per_s", "block_calls_in_process_per_s", "compile_ms", "gas_per_s", "record_gas")
    assert all(getattr(result.figures, name) > 0 for name in named)
    assert result.conditions["host_calls_per_record"] == 10
    assert {"nodes", "cores", "load", "python", "calls_a_block"} <= set(result.conditions)
    assert isinstance(result.profile, dict)
    assert sum(result.profile.values()) == pytest.approx(result.figures.record_cpu_us, abs=0.1)


def test_a_sample_counts_for_the_innermost_function_of_the_machine() -> None:
    frames: list[str] = []

    class Host(MemoryHost):
        def get(self, key: bytes) -> bytes | None:
            frames.append(group_of(sys._getframe(1)))
            return super().get(key)

    bench = RecordBench(load_contracts())
    entries, bench.host = bench.host.entries, Host()
    bench.host.entries = entries
    bench.record()
    assert set(frames) == {"host functions: state.get", "host functions: state.has"}
    assert group_of(None) == "other"


def test_a_block_of_the_benchmark_is_full_of_records_and_the_same_each_time() -> None:
    one, other = BlockBench(entries_count=200), BlockBench(entries_count=200)
    for _ in range(2):
        result = one.execute(one.next_transactions())
        assert result == other.execute(other.next_transactions())
        assert len(result.receipts) == one.calls_a_block
        assert one.calls_a_block == BLOCK_TRANSACTIONS_MAX_COUNT or result.gas_used > 0.9 * BLOCK_GAS_MAX
    assert one.head.state_root == result.state_root != one.state.state_root


def test_a_block_with_a_refused_call_is_no_measurement() -> None:
    bench = BlockBench(entries_count=200)
    transactions = bench.next_transactions()
    with pytest.raises(RuntimeError, match="RECORD_EXISTS"):
        bench.execute([transactions[0], transactions[0]])


def test_each_call_stores_one_record_and_a_refused_one_is_no_measurement() -> None:
    bench = RecordBench(load_contracts())
    for _ in range(3):
        bench.record()
    assert sum(key.startswith(b"records\x00record/") for key in bench.host.entries) == 3
    assert sum(key.startswith(b"records\x00of-visit/" + OWNER) for key in bench.host.entries) == 3
    with pytest.raises(RuntimeError, match="VISIT_UNKNOWN"):
        bench.invoke("close_visit", [b"\x03" + b"x" * 32, 0])
