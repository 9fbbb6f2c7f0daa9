"""Watching changes nothing: random programs end, cost and write the same watched, traced and left alone."""

from __future__ import annotations

from random import Random
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contracts.execution.call_host import CallHost
from contracts.kit.engine import watched_stack
from contracts.kit.recorder import Recorder
from contracts.state.view import MemoryState
from contracts.vm import CallContext, CompiledContract, Outcome, compile_contract, invoke
from tests.property.contract_programs import ProgramWriter

GAS = 100_000


def run(contract: CompiledContract, arguments: list[Any]) -> tuple[Outcome, dict[bytes, bytes | None]]:
    host = CallHost(MemoryState())
    context = CallContext(bytes(33), 1, 1, bytes(32), bytes(32))
    entry = contract.abi.entries[0].name
    with watched_stack():
        outcome = invoke(
            {"c": contract}, "c", entry, arguments, host=host, context=context, gas_limit=GAS, mode="export"
        )
    host.keep()
    return outcome, dict(host.writes)


@settings(suppress_health_check=list(HealthCheck), database=None)
@given(st.randoms(use_true_random=False))
def test_a_program_does_not_notice_that_it_is_watched(random: Random) -> None:
    source = ProgramWriter(random).program()
    numbers = random.choice([[], [1], [3, 1, 2]])
    arguments = [random.choice([0, 1, -1, 3, 2**64]), random.choice(["", "a,b", "12"]), numbers, {"b": 2, "a": -1}]
    alone = run(compile_contract(source, "c"), arguments)
    recorder = Recorder()
    watched = compile_contract(source, "c", watch=recorder.watch("c"))
    for tracing in (False, True):
        recorder.begin(tracing=tracing)
        assert run(watched, arguments) == alone
        recorder.finish("c", watched.abi.entries[0].line, alone[0].gas_used)
    spent = sum(line.gas for line in recorder.lines["c"].values())
    if alone[0].code != "OUT_OF_GAS":
        assert spent == alone[0].gas_used
