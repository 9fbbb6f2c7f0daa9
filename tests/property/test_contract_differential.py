"""What the language accepts runs the same under plain CPython: random programs, both ways, one outcome."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.primitives.encoding import decode_value
from contracts.vm import CallContext, Outcome, compile_contract, invoke
from tests.property.contract_programs import ProgramWriter
from tests.property.plain_python import run_plainly

CONTEXT = CallContext(caller=b"c" * 33, height=1, time_ms=2, txid=b"t" * 32, chain_id=b"i" * 32)
BUDGETS = {"OUT_OF_GAS", "MEMORY_BUDGET", "CALL_DEPTH", "WRITE_BUDGET", "EVENT_BUDGET"}
LIMITS = ("A stored value", "An event's data", "A result", "A key of a dict")


class DictHost:
    def __init__(self) -> None:
        self.entries: dict[bytes, bytes] = {}
        self.events: list[tuple[str, Any]] = []

    def get(self, key: bytes) -> bytes | None:
        return self.entries.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        self.entries[key] = value

    def delete(self, key: bytes) -> None:
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return [(key, self.entries[key]) for key in sorted(self.entries) if key.startswith(prefix)][:limit]

    def emit(self, name: str, data: bytes) -> None:
        self.events.append((name, decode_value(data)))


def run(source: str, arguments: list[Any]) -> tuple[Outcome, DictHost]:
    host = DictHost()
    contracts = {"it": compile_contract(source, "it")}
    outcome = invoke(contracts, "it", "f", arguments, host=host, context=CONTEXT, gas_limit=2_000_000, mode="export")
    return outcome, host


def compare(source: str, arguments: list[Any]) -> str:
    """Run a program both ways; return how it ended. Fails the test where the ends differ."""
    outcome, host = run(source, arguments)
    if outcome.code in BUDGETS or outcome.message.startswith(LIMITS):
        return "BUDGET"
    code, result, events, state = run_plainly(source, arguments)
    assert outcome.code == code, (
        f"{outcome.code} here, {code} in Python: {outcome.message} (line {outcome.line})\n{source}"
    )
    if outcome.ok:
        stored = {key.removeprefix(b"it\x00"): decode_value(value) for key, value in host.entries.items()}
        assert (outcome.result, host.events, stored) == (result, events, state), source
        assert repr(outcome.result) == repr(result), source
    return outcome.code


def arguments_of(random: Random) -> list[Any]:
    number = random.choice([0, 1, -1, 3, 2**64, -(2**200), 2**256 - 1])
    text = random.choice(["", "a", "a,b", "12", "é", "Ab 9"])
    numbers = random.choice([[], [1], [3, 1, 2], [2**255, 5]])
    table = random.choice([{}, {"a": 1}, {"b": 2, "a": -1, "": 0}])
    return [number, text, numbers, table]


def check_programs(examples: int) -> None:
    seen: dict[str, int] = {}

    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.randoms(use_true_random=False))
    def every_program_ends_the_same(random: Random) -> None:
        source = ProgramWriter(random).program()
        code = compare(source, arguments_of(random))
        seen[code] = seen.get(code, 0) + 1

    every_program_ends_the_same()
    assert seen.get("OK", 0) > sum(seen.values()) / 20, seen
    assert len(seen) >= 5, seen


def test_programs_end_the_same_under_plain_python():
    check_programs(150)


@pytest.mark.long
def test_many_programs_end_the_same_under_plain_python():
    check_programs(20_000)
