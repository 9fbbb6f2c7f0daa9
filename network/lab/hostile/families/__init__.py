"""The corpus of hostile programs, one module per kind of attack."""

from __future__ import annotations

from network.lab.hostile.families import (
    converting,
    crossing,
    flooding,
    growing,
    naming,
    nesting,
    probing,
    running,
    sources,
    working,
)
from network.lab.hostile.program import Program

FAMILIES: dict[str, tuple[Program, ...]] = {
    "running": running.PROGRAMS,
    "growing": growing.PROGRAMS,
    "converting": converting.PROGRAMS,
    "nesting": nesting.PROGRAMS,
    "probing": probing.PROGRAMS,
    "naming": naming.PROGRAMS,
    "flooding": flooding.PROGRAMS,
    "crossing": crossing.PROGRAMS,
    "working": working.PROGRAMS,
    "sources": sources.PROGRAMS,
}
"""The hostile programs by family."""

CORPUS: tuple[Program, ...] = tuple(program for programs in FAMILIES.values() for program in programs)
"""All hostile programs."""
