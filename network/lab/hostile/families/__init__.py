"""The corpus of hostile programs, one module per kind of attack."""

from __future__ import annotations

from network.lab.hostile.families import (
    conversion_attacks,
    cross_contract_attacks,
    flood_attacks,
    loop_attacks,
    memory_attacks,
    name_attacks,
    nesting_attacks,
    sandbox_attacks,
    source_attacks,
    work_attacks,
)
from network.lab.hostile.program import Program

FAMILIES: dict[str, tuple[Program, ...]] = {
    "running": loop_attacks.PROGRAMS,
    "growing": memory_attacks.PROGRAMS,
    "converting": conversion_attacks.PROGRAMS,
    "nesting": nesting_attacks.PROGRAMS,
    "probing": sandbox_attacks.PROGRAMS,
    "naming": name_attacks.PROGRAMS,
    "flooding": flood_attacks.PROGRAMS,
    "crossing": cross_contract_attacks.PROGRAMS,
    "working": work_attacks.PROGRAMS,
    "sources": source_attacks.PROGRAMS,
}
"""The hostile programs by family."""

CORPUS: tuple[Program, ...] = tuple(program for programs in FAMILIES.values() for program in programs)
"""All hostile programs."""
