"""What a mutant is: production code with one rule turned off, and the schedule under which that must show.

A schedule plays one seed and returns what broke. The same schedule without the mutant breaks nothing: so it is the
missing rule that is caught, and not something else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest

from network.sim.checkers import Violation

Play = Callable[[int], list[Violation]]
Change = Callable[[pytest.MonkeyPatch], None]


@dataclass(frozen=True)
class Schedule:
    """A way to play networks: `play(seed)` returns the violations. Within `seeds` every mutant of it is caught."""

    name: str
    play: Play
    seeds: Sequence[int]


@dataclass(frozen=True)
class Mutant:
    """`turn_off` changes production code in one place; then a checker of `caught_by` fires under `schedule`."""

    name: str
    rule: str
    turn_off: Change
    schedule: Schedule
    caught_by: frozenset[str]


@dataclass(frozen=True)
class Catch:
    """The first seed that shows a mutant, and what it shows."""

    seed: int
    violations: list[Violation]

    @property
    def checkers(self) -> frozenset[str]:
        """Which checkers fired."""
        return frozenset(violation.checker for violation in self.violations)


def hunt(mutant: Mutant) -> Catch | None:
    """Play the schedule's seeds with the mutant until one of its checkers fires."""
    with pytest.MonkeyPatch.context() as patch:
        mutant.turn_off(patch)
        for seed in mutant.schedule.seeds:
            violations = mutant.schedule.play(seed)
            if mutant.caught_by & {violation.checker for violation in violations}:
                return Catch(seed, violations)
    return None
