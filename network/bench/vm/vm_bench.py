"""Contract machine speed on `records.record`, alone and in blocks; median thread CPU time."""

from __future__ import annotations

import signal
import statistics
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import PurePath
from types import FrameType
from typing import Any

from msgspec import UNSET, Struct, UnsetType

from consensus.limits import CALL_GAS_MAX, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.encoding import encode_value, u64
from consensus.records.commitments import derive_record_id
from consensus.state import identity
from contracts.lifecycle.registry import PRIVACY_CONTRACTS, load_contracts, read_source
from contracts.vm import CallContext, CompiledContract, Outcome, compile_contract, invoke
from network.bench.conditions import Result, measure_conditions
from network.bench.vm.vm_blocks import measure_block_call_us
from network.bench.vm.worker_blocks import measure_block_calls_per_s

SAMPLE_EVERY_S = 0.001


_GROUPS = {
    "encoding.py": "values: encode, decode",
    "shapes.py": "values: encode, decode",
    "values.py": "values: walk, copy, charge",
    "host.py": "host functions",
    "invoke.py": "entry of calls",
    "abi.py": "entry of calls",
    "meter.py": "meter",
    "closures.py": "interpreter: expressions",
    "compiler_expressions.py": "interpreter: expressions",
    "compiler_statements.py": "interpreter: statements",
    "operations.py": "interpreter: operators, functions, methods",
    "builtins_table.py": "interpreter: operators, functions, methods",
    "methods.py": "interpreter: operators, functions, methods",
    "vm.py": "state in memory, the benchmark itself",
}


def group_of(frame: FrameType | None) -> str:
    while frame is not None:
        code = frame.f_code
        name = PurePath(code.co_filename).name
        if name == "host.py" and code.co_name.startswith("_state_"):
            return f"host functions: state.{code.co_name.removeprefix('_state_')}"
        if name in _GROUPS:
            return _GROUPS[name]
        frame = frame.f_back
    return "other"


def sample_shares(run: Callable[[], object], batches: int) -> dict[str, float]:
    """Each group's share of CPU time (0 to 1), largest first; main thread only."""
    samples: Counter[str] = Counter()

    def note(_: int, frame: FrameType | None) -> None:
        samples[group_of(frame)] += 1

    before = signal.signal(signal.SIGPROF, note)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_EVERY_S, SAMPLE_EVERY_S)
    try:
        for _ in range(batches):
            run()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    total = sum(samples.values())
    return {group: count / total for group, count in samples.most_common()}


ROBOT = b"\x02" + b"r" * 32
OWNER = b"\x03" + b"o" * 32
PURPOSE = "bench"
_NOW_MS = TIME_BUCKET_MS * 5_000_000
_CONTEXT = CallContext(ROBOT, 1, _NOW_MS + 1, b"t" * 32, b"c" * 32)
_COMPILE_ROUNDS_COUNT = 3
BATCH_CALLS_COUNT = 200


class MemoryHost:
    """A ledger's state in a dict."""

    def __init__(self) -> None:
        self.entries: dict[bytes, bytes] = {}

    def get(self, key: bytes) -> bytes | None:
        return self.entries.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        self.entries[key] = value

    def delete(self, key: bytes) -> None:
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return [(key, self.entries[key]) for key in sorted(self.entries) if key.startswith(prefix)][:limit]

    def emit(self, name: str, data: bytes) -> None: ...


class CountingHost(MemoryHost):
    """Also counts gets, puts and emits of `records.record`."""

    calls = 0

    def get(self, key: bytes) -> bytes | None:
        self.calls += 1
        return super().get(key)

    def put(self, key: bytes, value: bytes) -> None:
        self.calls += 1
        super().put(key, value)

    def emit(self, name: str, data: bytes) -> None:
        self.calls += 1
        super().emit(name, data)


class RecordBench:
    """A robot with one open visit, ready to record."""

    def __init__(self, contracts: Mapping[str, CompiledContract]) -> None:
        self.contracts = contracts
        self.host: MemoryHost = MemoryHost()
        self.count = 0
        text = {"role": "robot", "org": "bench", "status": "active"}
        robot = {"handle": b"h" * 32, **text, "since": _NOW_MS}
        self.host.entries[identity.MEMBER.key(ROBOT)] = encode_value(robot)
        self.host.entries[identity.PURPOSE.key(PURPOSE)] = encode_value(True)
        self.invoke("open_visit", [OWNER, b"\x02" + b"e" * 32, 7, _NOW_MS, PURPOSE])
        self._opened = self.host.entries.copy()

    def invoke(self, entry: str, arguments: list[Any]) -> Outcome:
        outcome = invoke(
            self.contracts, "records", entry, arguments,
            host=self.host, context=_CONTEXT, gas_limit=CALL_GAS_MAX, mode="export",
        )  # fmt: skip
        if not outcome.ok:
            raise RuntimeError(f"records.{entry} failed in line {outcome.line}: {outcome.code}: {outcome.message}")
        return outcome

    def next_arguments(self) -> list[Any]:
        self.count += 1
        root, metadata = u64(self.count) * 4, b"m" * SEALED_METADATA_BYTES
        return [derive_record_id(OWNER, root), OWNER, root, b"2" * 32, metadata, _NOW_MS, _NOW_MS + 1_000_000]

    def record(self) -> Outcome:
        return self.invoke("record", self.next_arguments())

    def run_batch(self) -> float:
        """Return the calls' CPU seconds."""
        self.host.entries = self._opened.copy()
        batch = [self.next_arguments() for _ in range(BATCH_CALLS_COUNT)]
        started = time.thread_time()
        for arguments in batch:
            self.invoke("record", arguments)
        return time.thread_time() - started

    def count_host_calls(self) -> int:
        counting = CountingHost()
        counting.entries = self.host.entries
        self.host = counting
        self.record()
        return counting.calls


def measure_compile_ms() -> float:
    """Median CPU time for the privacy contracts, from text."""
    sources = {name: read_source(name) for name in PRIVACY_CONTRACTS}
    rounds: list[float] = []
    for _ in range(_COMPILE_ROUNDS_COUNT):
        started = time.thread_time()
        for name, source in sources.items():
            compile_contract(source, name)
        rounds.append(time.thread_time() - started)
    return statistics.median(rounds) * 1000


def measure_record_us(seconds: float) -> tuple[list[float], int]:
    """CPU µs of one `records.record` per batch, and its gas. Runs about `seconds` of CPU time, at least two batches."""
    bench = RecordBench(load_contracts())
    gas = bench.record().gas_used
    each: list[float] = []
    spent = 0.0
    while spent < seconds or len(each) < 2:
        took = bench.run_batch()
        spent += took
        each.append(took / BATCH_CALLS_COUNT * 1e6)
    return each, gas


class VmFigures(Struct, frozen=True, kw_only=True):
    """What the contract machine costs: a call alone, and a call in a block."""

    record_calls_per_s: float
    record_cpu_us: float
    record_best_us: float
    record_gas: int
    gas_per_s: int
    block_calls_in_process_per_s: float
    block_call_cpu_us: float
    compile_ms: float
    block_calls_per_s: float


class VmResult(Result[VmFigures], kw_only=True):
    """`profile`: microseconds of a call by what they go to; absent unless asked for."""

    profile: dict[str, float] | UnsetType = UNSET


def run_vm_benchmark(seconds: float = 3, *, profile: bool = False) -> VmResult:
    """About `seconds` CPU time each; `profile` adds where the time goes."""
    conditions = measure_conditions(nodes=0)
    compile_ms = measure_compile_ms()
    records, gas = measure_record_us(seconds)
    calls, calls_a_block = measure_block_call_us(seconds)
    record_us, call_us = statistics.median(records), statistics.median(calls)
    figures = VmFigures(
        record_calls_per_s=round(1e6 / record_us, 1),
        record_cpu_us=round(record_us, 2),
        record_best_us=round(min(records), 2),
        record_gas=gas,
        gas_per_s=round(gas * 1e6 / record_us),
        block_calls_in_process_per_s=round(1e6 / call_us, 1),
        block_call_cpu_us=round(call_us, 2),
        compile_ms=round(compile_ms, 2),
        block_calls_per_s=round(measure_block_calls_per_s(seconds), 1),
    )
    conditions |= {
        "clock": "thread CPU time",
        "figure": "median of batches",
        "batches": len(records),
        "blocks": len(calls),
        "calls_a_block": calls_a_block,
        "host_calls_per_record": RecordBench(load_contracts()).count_host_calls(),
        "contracts": len(PRIVACY_CONTRACTS),
    }
    result = VmResult(name="vm", ok=True, figures=figures, conditions=conditions)
    if profile:
        bench = RecordBench(load_contracts())
        shares = sample_shares(bench.run_batch, max(10, round(seconds * 1e6 / record_us / BATCH_CALLS_COUNT)))
        result.profile = {group: round(share * record_us, 2) for group, share in shares.items()}
    return result
