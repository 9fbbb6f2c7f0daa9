"""CPU time per gas of each program: its call, and the trie's for writes."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from contracts.state.trie import apply_batch
from contracts.vm import ContractSourceError
from contracts.vm.model.faults import OUT_OF_GAS
from network.lab.hostile.program import REFUSED, Program
from network.lab.hostile.running import call_before, call_program, compile_program, make_state

GAS_LIMIT = 1_000_000
GAS_COUNTED_MIN = 40_000
"""A program that uses less is not measured: what its call costs in addition to its steps would be most of the figure."""
SURE_ROUNDS_COUNT = 7
EXTREMES_COUNT = 12


@dataclass(frozen=True, slots=True)
class Price:
    """A program's outcome, gas used, and CPU seconds per million gas."""

    name: str
    code: str
    gas_used: int
    seconds_per_million_gas: float


def measure_program(program: Program, *, rounds: int = 3, gas_limit: int = GAS_LIMIT) -> Price | None:
    """Median run on fresh states; None if too little gas was used. Writes of failed calls count as kept, since similar ones
    may succeed.
    """
    if program.at_once or program.expect.startswith(REFUSED):
        return None
    try:
        contracts = compile_program(program)
    except ContractSourceError:
        return None
    state = make_state(program)
    spent: list[float] = []
    code, used = "", 0
    for _ in range(rounds):
        host = call_before(program, contracts, state)
        before = dict(host.writes)
        host.begin()
        gc.collect()
        gc.disable()
        started = time.thread_time()
        outcome = call_program(program, contracts, host, gas_limit)
        host.keep()
        writes = {key: value for key, value in host.writes.items() if key not in before or before[key] is not value}
        if writes:
            apply_batch(state, state.state_root, writes)
        code, used = outcome.code, outcome.gas_used
        del outcome
        spent.append(time.thread_time() - started)
        gc.enable()
        if used < GAS_COUNTED_MIN:
            return None
    return Price(program.name, code, used, median(spent) / used * 1_000_000)


def measure_all(programs: Iterable[Program], *, rounds: int = 3, gas_limit: int = GAS_LIMIT) -> list[Price]:
    """Dearest first."""
    given = {program.name: program for program in programs}
    measured = (measure_program(program, rounds=rounds, gas_limit=gas_limit) for program in given.values())
    prices = sorted((price for price in measured if price is not None), key=_seconds)
    ends = {price.name for price in [*prices[-EXTREMES_COUNT:], *cheapest_first(prices)[:EXTREMES_COUNT]]}
    sure: dict[str, Price] = {price.name: price for price in prices}
    for name in sorted(ends) * SURE_ROUNDS_COUNT:
        price = measure_program(given[name], rounds=1, gas_limit=gas_limit)
        if price is not None:
            sure[name] = min(sure[name], price, key=_seconds)
    return sorted(sure.values(), key=_seconds, reverse=True)


def cheapest_first(prices: Iterable[Price]) -> list[Price]:
    return sorted((price for price in prices if price.code == OUT_OF_GAS), key=_seconds)


def _seconds(price: Price) -> float:
    return price.seconds_per_million_gas
