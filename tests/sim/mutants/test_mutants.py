"""Each rule is turned off in turn, and must be missed; with all of them on, the same schedules break nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.sim.mutants.mutant import Mutant, Schedule, hunt
from tests.sim.mutants.registry import MUTANTS, SCHEDULES

SLOW_MUTANTS = {"confirm nothing", "erase as a keeper only", "repair nothing", "trust a restored journal"}
"""Of few seeds that show them, or of large networks: together they take as long as all others."""
SLOW_CONTROLS = {"changes", "chaos", "custody", "flood of expired transactions", "halves", "old journal", "power cuts"}
"""Schedules that take longest without a mutant, since all of their seeds are played."""


def sort_into_tiers(them: Sequence[Mutant] | Sequence[Schedule], slow: set[str]) -> list[Any]:
    """The slow ones are for the long tier."""
    assert slow <= {one.name for one in them}
    return [pytest.param(one, id=one.name, marks=[pytest.mark.long] if one.name in slow else []) for one in them]


@pytest.mark.parametrize("mutant", sort_into_tiers(MUTANTS, SLOW_MUTANTS))
def test_a_rule_that_is_turned_off_is_missed(mutant: Mutant) -> None:
    caught = hunt(mutant)
    assert caught is not None, f"{mutant.name}: no seed of {mutant.schedule.name} shows it"


@pytest.mark.parametrize("schedule", sort_into_tiers(SCHEDULES, SLOW_CONTROLS))
def test_with_all_rules_on_the_same_schedule_breaks_nothing(schedule: Schedule) -> None:
    for seed in schedule.seeds:
        assert [str(violation) for violation in schedule.play(seed)] == [], seed


def test_every_mutant_has_a_row_in_the_table() -> None:
    table = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    rows = [line for line in table.splitlines() if line.startswith("| ") and "`" in line]
    missing = [
        mutant.name for mutant in MUTANTS if not any(f"| {mutant.name} | {mutant.rule} |" in row for row in rows)
    ]
    assert missing == []
    assert len(rows) == len(MUTANTS) >= 16
