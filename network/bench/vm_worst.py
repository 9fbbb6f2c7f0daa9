"""What a million gas is in CPU time, from the cheapest program to the dearest. Must never judge by any other clock.

Runs the hostile corpus and a small program for every operation, builtin, method and host function. Programs that another
budget ends count among the dearest, not among the cheapest: they never get to use their gas.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from contracts.vm import LANGUAGE_VERSION
from network.bench.conditions import build_result, measure_conditions
from network.hostile.corpus import CORPUS
from network.hostile.measuring import GAS_LIMIT, cheapest_first, measure_all
from network.hostile.micro import MICRO
from network.hostile.program import Program

RATIO_MAX = 10.0
PROGRAMS: tuple[Program, ...] = (*MICRO, *CORPUS)


def run_worst_benchmark(programs: Iterable[Program] = PROGRAMS, *, rounds: int = 3) -> dict[str, Any]:
    """Measure the programs; return name, ok (the ratio is at most ten), figures, conditions and the table."""
    conditions = measure_conditions(nodes=0)
    prices = measure_all(programs, rounds=rounds)
    dearest, cheapest = prices[0], cheapest_first(prices)[0]
    ratio = dearest.seconds_per_million_gas / cheapest.seconds_per_million_gas
    middle = prices[len(prices) // 2]
    figures = {
        "programs": len(prices),
        "dearest": dearest.name,
        "dearest_ms_per_million_gas": round(dearest.seconds_per_million_gas * 1000, 2),
        "median_ms_per_million_gas": round(middle.seconds_per_million_gas * 1000, 2),
        "cheapest": cheapest.name,
        "cheapest_ms_per_million_gas": round(cheapest.seconds_per_million_gas * 1000, 2),
        "ratio": round(ratio, 2),
    }
    more = {"clock": "thread CPU time", "rounds": rounds, "gas": GAS_LIMIT, "language": LANGUAGE_VERSION}
    result = build_result("vm-worst", ok=ratio <= RATIO_MAX, figures=figures, conditions={**conditions, **more})
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
