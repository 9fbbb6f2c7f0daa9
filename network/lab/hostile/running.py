"""Runs one program as in a block and returns the outcome."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

from consensus.primitives.encoding import encode_value
from consensus.state.keys import flat_prefix
from contracts.execution.call_host import CallHost
from contracts.state.view import MemoryState, Overlay, StateView
from contracts.vm import CallContext, CompiledContract, ContractSourceError, Outcome, compile_contract, invoke
from contracts.vm.compiler.compile_cache import compile_once
from network.lab.hostile.program import REFUSED, Program

CONTRACT = "it"
CALLER = b"\x02" + b"c" * 32
CONTEXT = CallContext(caller=CALLER, height=7, time_ms=1_700_000_000_000, txid=b"t" * 32, chain_id=b"i" * 32)


@dataclass(frozen=True, slots=True)
class Finding:
    """A program's outcome (as `Program.expect`), gas, and digest of all effects."""

    name: str
    came_to: str
    gas_used: int
    digest: str
    places: str = ""

    @property
    def everywhere(self) -> tuple[str, str, int, str]:
        came_to = REFUSED if self.came_to.startswith(REFUSED) else self.came_to
        return self.name, came_to, self.gas_used, self.digest

    def fits(self, program: Program) -> bool:
        if program.expect.startswith(REFUSED) and self.came_to.startswith(REFUSED):
            wanted = program.expect.removeprefix(REFUSED)
            return not wanted or wanted in self.came_to.removeprefix(REFUSED).split(",")
        return self.came_to in program.expect.split("|")


def make_state(program: Program) -> MemoryState:
    state = MemoryState()
    prefix = flat_prefix(CONTRACT)
    state.apply({prefix + key: encode_value(value) for key, value in program.state.items()})
    return state


def compile_program(program: Program) -> dict[str, CompiledContract]:
    """Raises ContractSourceError if a contract is rejected."""
    others = {name: compile_once(text, name) for name, text in program.others.items()}
    return {CONTRACT: compile_contract(program.source, CONTRACT), **others}


def call_program(
    program: Program, contracts: dict[str, CompiledContract], host: CallHost, gas: int | None = None
) -> Outcome:
    mode: Any = program.mode
    return invoke(
        contracts, CONTRACT, "f", list(program.args),
        host=host, context=CONTEXT, gas_limit=program.gas if gas is None else gas, mode=mode,
    )  # fmt: skip


def call_before(program: Program, contracts: dict[str, CompiledContract], state: StateView) -> CallHost:
    """Make the earlier calls; return the block's host. Raises RuntimeError if one fails."""
    host = CallHost(state)
    for number, calls in enumerate(program.blocks_before):
        if number:
            state = Overlay.apply(state, host.writes)
            host = CallHost(state)
        for args in calls:
            host.begin()
            outcome = call_program(replace(program, args=args), contracts, host)
            if not outcome.ok:
                raise RuntimeError(f"a call before {program.name} failed: {outcome.code}")
            host.keep()
    return host


def run_program(program: Program) -> Finding:
    """Compile and call a program on a fresh state. Raises InternalFault if the machine fails."""
    try:
        contracts = compile_program(program)
    except ContractSourceError as refusal:
        codes = ",".join(sorted({one.code for one in refusal.diagnostics}))
        places = "|".join(f"{one.line}:{one.column} {one.code}" for one in refusal.diagnostics)
        digest = hashlib.sha256(repr(refusal.verdict).encode("utf-8", "backslashreplace")).hexdigest()
        return Finding(program.name, REFUSED + codes, 0, digest, hashlib.sha256(places.encode()).hexdigest())
    host = call_before(program, contracts, make_state(program))
    host.begin()
    outcome = call_program(program, contracts, host)
    if outcome.ok:
        host.keep()
    left = [outcome.code, outcome.message, outcome.line, outcome.gas_used, outcome.result, sorted(host.writes.items())]
    text = repr([*left, outcome.events])
    return Finding(program.name, outcome.code, outcome.gas_used, hashlib.sha256(text.encode()).hexdigest())
