"""CPU time of a million gas, cheapest to dearest program, against an empty loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from consensus.chain.epoch_settings import ChainSettings
from consensus.limits import BLOCK_GAS_MAX
from contracts.vm import LANGUAGE_VERSION
from network.bench.conditions import build_result, measure_conditions
from network.lab.hostile.corpus import CORPUS
from network.lab.hostile.measuring import GAS_LIMIT, cheapest_first, measure_all
from network.lab.hostile.micro import MICRO
from network.lab.hostile.places import PLACES
from network.lab.hostile.program import Program
from network.lab.hostile.searching import REFERENCE, SURE_ROUNDS_COUNT, confirm, measure_reliably, search

RATIO_MAX = 10.0
BLOCK_MAX_MS = ChainSettings().base_timeout_ms / 4
"""So long a block of nothing but the dearest program may take: two calls fill one."""
PROGRAMS: tuple[Program, ...] = (*MICRO, *PLACES, *CORPUS)


def measure_reference() -> float:
    """Return CPU ms of a million gas of the reference."""
    price = measure_reliably(REFERENCE, SURE_ROUNDS_COUNT, GAS_LIMIT)
    assert price is not None
    return price.seconds_per_million_gas * 1000


def _build(
    name: str, figures: dict[str, Any], dearest_ms: float, reference_ms: float, conditions: dict[str, Any]
) -> Any:
    ratio, block_ms = dearest_ms / reference_ms, dearest_ms * BLOCK_GAS_MAX / 1_000_000
    figures |= {
        "dearest_ms_per_million_gas": round(dearest_ms, 2),
        "reference_ms_per_million_gas": round(reference_ms, 2),
        "ratio": round(ratio, 2),
        "block_of_the_dearest_ms": round(block_ms, 1),
        "block_max_ms": BLOCK_MAX_MS,
    }
    ok = ratio <= RATIO_MAX and block_ms <= BLOCK_MAX_MS
    more = {"clock": "thread CPU time", "gas": GAS_LIMIT, "language": LANGUAGE_VERSION}
    return build_result(name, ok=ok, figures=figures, conditions={**conditions, **more})


def run_worst_benchmark(programs: Iterable[Program] = PROGRAMS, *, rounds: int = 3) -> dict[str, Any]:
    """Measure programs; `ok` if the dearest is at most ten times the reference."""
    conditions = {**measure_conditions(nodes=0), "rounds": rounds}
    prices = measure_all(programs, rounds=rounds)
    dearest, cheapest, middle = prices[0], cheapest_first(prices)[0], prices[len(prices) // 2]
    figures = {
        "programs": len(prices),
        "dearest": dearest.name,
        "median_ms_per_million_gas": round(middle.seconds_per_million_gas * 1000, 2),
        "cheapest": cheapest.name,
        "cheapest_ms_per_million_gas": round(cheapest.seconds_per_million_gas * 1000, 2),
    }
    result: dict[str, Any] = _build(
        "vm-worst", figures, dearest.seconds_per_million_gas * 1000, measure_reference(), conditions
    )
    result["programs"] = [
        {
            "name": price.name,
            "ms_per_million_gas": round(price.seconds_per_million_gas * 1000, 2),
            "gas_used": price.gas_used,
            "code": price.code,
        }
        for price in prices
    ]
    return result


def run_worst_search(minutes: float, seed: int, tell: Callable[[str], None]) -> dict[str, Any]:
    conditions = {**measure_conditions(nodes=0), "seed": seed}
    started = time.monotonic()
    found = search(minutes * 60, seed, tell)
    before = measure_reference()
    sure = confirm(found)
    reference_ms = min(before, measure_reference())
    figures = {"programs": found.tried, "counted": found.counted, "dearest": sure[0][0].name if sure else ""}
    figures |= {"cpu_minutes": round(found.cpu_s / 60, 2), "minutes": round((time.monotonic() - started) / 60, 2)}
    dearest_ms = sure[0][0].seconds_per_million_gas * 1000 if sure else 0.0
    result: dict[str, Any] = _build("vm-worst-search", figures, dearest_ms, reference_ms, conditions)
    result["programs"] = [
        {
            "name": price.name,
            "ms_per_million_gas": round(price.seconds_per_million_gas * 1000, 2),
            "ratio": round(price.seconds_per_million_gas * 1000 / reference_ms, 2),
            "gas_used": price.gas_used,
            "code": price.code,
            "source": program.source.split("\ndef f():\n")[1],
        }
        for price, program in sure
    ]
    return result
