"""A watched contract tells of every statement, and does and costs exactly what the unwatched one does."""

from __future__ import annotations

from typing import Any

import pytest

from contracts.execution.call_host import CallHost
from contracts.state.view import MemoryState
from contracts.vm import CallContext, CompiledContract, Outcome, compile_contract, invoke
from contracts.vm.compiler.line_watch import Place

SOURCE = '''"""A contract with every kind of statement."""

STEP = 2


def double(n: int) -> int:
    if n < 0:
        return 0
    elif n == 0:
        return 1
    return n * STEP


@export
def act(limit: int) -> list:
    """Walk about."""
    found = []
    n = 0
    while n < limit:
        n += 1
        if n == 3:
            continue
        for other in range(n):
            if other > 2:
                break
            found.append(double(other))
    pair = [n, len(found)]
    first, second = pair
    state.put(b"n", first)
    del found[0]
    require(second < 9, "TOO_MANY", "Too many.")
    emit("acted", {"n": n})
    return found


@export
def spin():
    n = 1
    while True:
        n = n + n % 7
'''


class Recorder:
    """Notes whatever it hears, with the depth at which it heard it."""

    def __init__(self) -> None:
        self.declared: list[int] = []
        self.heard: list[tuple[int, dict[str, Any]]] = []
        self.depth = self.gas_of_roots = 0
        self._at: list[int] = []

    def declare(self, place: Place) -> None:
        self.declared.append(place.line)

    def enter(self, place: Place, frame: list[Any], gas: int) -> None:
        self.heard.append((place.line, {name: frame[slot] for name, slot in place.slots.items()}))
        self._at.append(gas + place.static_gas)

    def leave(self, place: Place, frame: list[Any], gas: int) -> None:
        began = self._at.pop()
        if not self._at:
            self.gas_of_roots += began - gas


def run(
    contract: CompiledContract, entry: str, *arguments: Any, gas: int = 100_000
) -> tuple[Outcome, dict[bytes, Any]]:
    host = CallHost(MemoryState())
    context = CallContext(bytes(33), 1, 1, bytes(32), bytes(32))
    outcome = invoke(
        {"c": contract}, "c", entry, list(arguments), host=host, context=context, gas_limit=gas, mode="export"
    )
    host.keep()
    return outcome, dict(host.writes)


@pytest.mark.parametrize(
    ("entry", "arguments"), [("act", [2]), ("act", [4]), ("act", [50]), ("act", ["x"]), ("spin", [])]
)
def test_a_watched_run_ends_and_costs_as_an_unwatched_one(entry: str, arguments: list[Any]) -> None:
    plain, watched = compile_contract(SOURCE, "c"), compile_contract(SOURCE, "c", watch=Recorder())
    assert run(plain, entry, *arguments) == run(watched, entry, *arguments)


def test_every_statement_that_runs_is_heard_with_its_values() -> None:
    recorder = Recorder()
    outcome, _ = run(compile_contract(SOURCE, "c", watch=recorder), "act", 2)
    assert outcome.ok
    lines = [line for line, _ in recorder.heard]
    assert lines[:7] == [17, 18, 19, 20, 21, 23, 24]
    assert sorted(set(lines)) == [7, 10, 11, *range(17, 22), 23, 24, 26, *range(27, 34)]
    assert sorted(recorder.declared) == [7, 8, 10, 11, *range(17, 34), 38, 39, 40]
    assert [recorder.heard[place][1]["n"] for place in (2, 3, 4)] == [0, 0, 1]


def test_statements_cost_all_but_entering_and_are_left_after_a_fault() -> None:
    recorder = Recorder()
    outcome, _ = run(compile_contract(SOURCE, "c", watch=recorder), "act", 4)
    rest = outcome.gas_used - recorder.gas_of_roots
    assert 50 < rest < 150
    outcome, _ = run(compile_contract(SOURCE, "c", watch=recorder), "act", 20)
    assert (outcome.code, outcome.line) == ("TOO_MANY", 31)
    assert recorder.heard[-1][0] == 31
    assert recorder._at == []
