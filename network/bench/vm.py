"""How fast the contract machine is: the real `records.record`, over a state in memory. Must never touch a node or a disk.

Measured in CPU time of this thread, so that a busy machine does not change the figures much. Not included: signatures,
the trie, storage.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from consensus.limits import CALL_GAS_MAX, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.encoding import encode_value, u64
from contracts.execution.registry import PRIVACY_CONTRACTS, load_contracts, read_source
from contracts.vm import CallContext, CompiledContract, Outcome, compile_contract, invoke
from network.bench.conditions import build_result, measure_conditions

ROBOT = b"\x02" + b"r" * 32
OWNER = b"\x03" + b"o" * 32
PURPOSE = "bench"
_NOW_MS = TIME_BUCKET_MS * 5_000_000
_COMPILE_ROUNDS_COUNT = 3
_BATCH_CALLS_COUNT = 50


class MemoryHost:
    """A ledger's state in a dict, counting how often it is asked."""

    def __init__(self) -> None:
        self.entries: dict[bytes, bytes] = {}
        self.calls = 0

    def get(self, key: bytes) -> bytes | None:
        """Return the value under a key."""
        self.calls += 1
        return self.entries.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        """Store a value."""
        self.calls += 1
        self.entries[key] = value

    def delete(self, key: bytes) -> None:
        """Remove a key."""
        self.calls += 1
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        """Return the entries under a prefix, in key order."""
        self.calls += 1
        return [(key, self.entries[key]) for key in sorted(self.entries) if key.startswith(prefix)][:limit]

    def emit(self, name: str, data: bytes) -> None:  # noqa: ARG002 - the events of a benchmark go nowhere
        """Count an event."""
        self.calls += 1


class RecordBench:
    """A robot with one open visit, ready to record clip after clip."""

    def __init__(self, contracts: Mapping[str, CompiledContract]) -> None:
        self.contracts = contracts
        self.host = MemoryHost()
        self.count = 0
        self.gas_used = 0
        robot: dict[str, Any] = {"handle": b"h" * 32, "role": "robot", "org": "bench", "status": "active"}
        robot |= {"purposes": [PURPOSE], "since": _NOW_MS}
        self.host.entries[b"identity\x00member/" + ROBOT] = encode_value(robot)
        self.host.entries[b"identity\x00purpose/" + PURPOSE.encode()] = encode_value(True)
        self.invoke("open_visit", [OWNER, b"\x02" + b"e" * 32, 7, _NOW_MS, PURPOSE])

    def invoke(self, entry: str, arguments: list[Any]) -> Outcome:
        """Call an entry of `records` as the robot. Raises RuntimeError if the contract refuses."""
        context = CallContext(ROBOT, 1, _NOW_MS + 1, b"t" * 32, b"c" * 32)
        outcome = invoke(
            self.contracts, "records", entry, arguments,
            host=self.host, context=context, gas_limit=CALL_GAS_MAX, mode="export",
        )  # fmt: skip
        if not outcome.ok:
            raise RuntimeError(f"records.{entry} failed in line {outcome.line}: {outcome.code}: {outcome.message}")
        return outcome

    def record(self) -> Outcome:
        """Record one clip under a new id."""
        self.count += 1
        record_id = u64(self.count) * 2
        metadata = b"m" * SEALED_METADATA_BYTES
        arguments = [record_id, OWNER, b"1" * 32, b"2" * 32, metadata, _NOW_MS, _NOW_MS + 1_000_000]
        outcome = self.invoke("record", arguments)
        self.gas_used += outcome.gas_used
        return outcome


def measure_compile_ms() -> float:
    """Return the best CPU time in milliseconds to compile all shipped contracts, each from its text."""
    sources = {name: read_source(name) for name in PRIVACY_CONTRACTS}
    best = float("inf")
    for _ in range(_COMPILE_ROUNDS_COUNT):
        started = time.thread_time()
        for name, source in sources.items():
            compile_contract(source, name)
        best = min(best, time.thread_time() - started)
    return best * 1000


def run_vm_benchmark(seconds: float = 3) -> dict[str, Any]:
    """Call `records.record` for about `seconds` of CPU time and return name, ok, figures and conditions."""
    conditions = measure_conditions(nodes=0)
    compile_ms = measure_compile_ms()
    bench = RecordBench(load_contracts())
    calls_before = bench.host.calls
    first_gas = bench.record().gas_used
    host_calls = bench.host.calls - calls_before
    bench.count, bench.gas_used, spent = 1, 0, 0.0
    while spent < seconds:
        bench.host.entries = {key: value for key, value in bench.host.entries.items() if b"\x00record/" not in key}
        started = time.thread_time()
        for _ in range(_BATCH_CALLS_COUNT):
            bench.record()
        spent += time.thread_time() - started
    calls = bench.count - 1
    figures = {
        "record_calls_per_s": round(calls / spent, 1),
        "record_cpu_us": round(spent / calls * 1e6, 2),
        "record_gas": first_gas,
        "gas_per_s": round(bench.gas_used / spent),
        "compile_ms": round(compile_ms, 2),
    }
    more = {"clock": "thread CPU time", "host_calls_per_record": host_calls, "contracts": len(PRIVACY_CONTRACTS)}
    return build_result("vm", ok=True, figures=figures, conditions={**conditions, **more})
