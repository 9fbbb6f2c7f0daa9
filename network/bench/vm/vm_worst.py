"""CPU time of a million gas, cheapest to dearest program, against an empty loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from msgspec import UNSET, Struct, UnsetType

from consensus.chain.epoch_settings import ChainSettings
from consensus.limits import BLOCK_GAS_MAX
from contracts.vm import LANGUAGE_VERSION
from network.bench.conditions import Condition, Result, measure_conditions
from network.lab.hostile.families import CORPUS
from network.lab.hostile.measuring import GAS_LIMIT, Price, cheapest_first, measure_all
from network.lab.hostile.micro import MICRO
from network.lab.hostile.places import PLACES
from network.lab.hostile.program import Program
from network.lab.hostile.searching import REFERENCE, SURE_ROUNDS_COUNT, confirm, measure_reliably, search

RATIO_MAX = 10.0
BLOCK_MAX_MS = ChainSettings().base_timeout_ms / 4
"""So long a block of nothing but the dearest program may take: two calls fill one."""
PROGRAMS: tuple[Program, ...] = (*MICRO, *PLACES, *CORPUS)


def measure_reference() -> float:
    """CPU ms of a million gas."""
    price = measure_reliably(REFERENCE, SURE_ROUNDS_COUNT, GAS_LIMIT)
    assert price is not None
    return price.seconds_per_million_gas * 1000


class DearestFigures(Struct, kw_only=True):
    """The dearest of the measured programs, beside the reference."""

    programs: int
    dearest: str
    dearest_ms_per_million_gas: float
    reference_ms_per_million_gas: float
    ratio: float = 0.0
    block_of_the_dearest_ms: float = 0.0
    block_max_ms: float = BLOCK_MAX_MS


class WorstFigures(DearestFigures, kw_only=True):
    """Also the cheapest and the median."""

    median_ms_per_million_gas: float
    cheapest: str
    cheapest_ms_per_million_gas: float


class SearchFigures(DearestFigures, kw_only=True):
    """Also how much was searched."""

    counted: int
    cpu_minutes: float
    minutes: float


class ProgramRow(Struct, frozen=True, kw_only=True):
    """What a program costs; those of a search come with their source."""

    name: str
    ms_per_million_gas: float
    ratio: float | UnsetType = UNSET
    gas_used: int
    code: str
    source: str | UnsetType = UNSET


D = TypeVar("D", bound=DearestFigures)


class WorstResult(Result[D], kw_only=True):
    """`programs`: each one, dearest first."""

    programs: list[ProgramRow]


def _judge(name: str, figures: D, programs: list[ProgramRow], conditions: dict[str, Condition]) -> WorstResult[D]:
    dearest_ms, reference_ms = figures.dearest_ms_per_million_gas, figures.reference_ms_per_million_gas
    ratio, block_ms = dearest_ms / reference_ms, dearest_ms * BLOCK_GAS_MAX / 1_000_000
    ok = ratio <= RATIO_MAX and block_ms <= BLOCK_MAX_MS
    figures.dearest_ms_per_million_gas = round(dearest_ms, 2)
    figures.reference_ms_per_million_gas = round(reference_ms, 2)
    figures.ratio, figures.block_of_the_dearest_ms = round(ratio, 2), round(block_ms, 1)
    conditions |= {"clock": "thread CPU time", "gas": GAS_LIMIT, "language": LANGUAGE_VERSION}
    return WorstResult(name=name, ok=ok, figures=figures, conditions=conditions, programs=programs)


def _ms(price: Price) -> float:
    return price.seconds_per_million_gas * 1000


def run_worst_benchmark(programs: Iterable[Program] = PROGRAMS, *, rounds: int = 3) -> WorstResult[WorstFigures]:
    """`ok` if the dearest is at most ten times the reference."""
    conditions = measure_conditions(nodes=0, rounds=rounds)
    prices = measure_all(programs, rounds=rounds)
    dearest, cheapest, middle = prices[0], cheapest_first(prices)[0], prices[len(prices) // 2]
    figures = WorstFigures(
        programs=len(prices),
        dearest=dearest.name,
        dearest_ms_per_million_gas=_ms(dearest),
        reference_ms_per_million_gas=measure_reference(),
        median_ms_per_million_gas=round(_ms(middle), 2),
        cheapest=cheapest.name,
        cheapest_ms_per_million_gas=round(_ms(cheapest), 2),
    )
    rows = [
        ProgramRow(name=price.name, ms_per_million_gas=round(_ms(price), 2), gas_used=price.gas_used, code=price.code)
        for price in prices
    ]
    return _judge("vm-worst", figures, rows, conditions)


def run_worst_search(minutes: float, seed: int, on_progress: Callable[[str], None]) -> WorstResult[SearchFigures]:
    conditions = measure_conditions(nodes=0, seed=seed)
    started = time.monotonic()
    found = search(minutes * 60, seed, on_progress)
    before = measure_reference()
    sure = confirm(found)
    reference_ms = min(before, measure_reference())
    figures = SearchFigures(
        programs=found.tried,
        counted=found.counted,
        dearest=sure[0][0].name if sure else "",
        dearest_ms_per_million_gas=_ms(sure[0][0]) if sure else 0.0,
        reference_ms_per_million_gas=reference_ms,
        cpu_minutes=round(found.cpu_s / 60, 2),
        minutes=round((time.monotonic() - started) / 60, 2),
    )
    rows = [
        ProgramRow(
            name=price.name,
            ms_per_million_gas=round(_ms(price), 2),
            ratio=round(_ms(price) / reference_ms, 2),
            gas_used=price.gas_used,
            code=price.code,
            source=program.source.split("\ndef f():\n")[1],
        )
        for price, program in sure
    ]
    return _judge("vm-worst-search", figures, rows, conditions)
