"""Mistakes that were made in the product on purpose are missed by the tests of the default tier."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.mutant import DroppedCheck, Mutant, Replaced, apply_to
from tests.mutants.table import MUTANTS

ROOT = Path(__file__).resolve().parents[2]
PLAYED_MAX_S = 3_000


def test_there_are_enough_of_them_and_each_has_its_own_name() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS) >= 60


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_each_changes_its_module_into_another_that_python_reads(mutant: Mutant) -> None:
    changed = apply_to(mutant, ROOT)
    assert changed != (ROOT / mutant.file).read_text(encoding="utf-8")
    ast.parse(changed)
    assert all((ROOT / test.partition("::")[0]).is_file() for test in mutant.killed_by.split())


def test_a_check_is_dropped_alone() -> None:
    refusal = '    raise BlockRobotError("X", "é")\n'
    source = f'if a:\n{refusal}if b(\n    1\n):\n{refusal}require(c, "X", "d")\n'
    kept = ["if a:", "if b(", "require(c"]
    for number, text in enumerate(kept):
        changed = DroppedCheck("f", "X", number, "").apply(source)
        assert [other in changed for other in kept] == [other != text for other in kept]
    assert "require(True," in DroppedCheck("f", "X", 2, "").apply(source)
    with pytest.raises(ValueError, match="3 such checks"):
        DroppedCheck("f", "X", 3, "").apply(source)
    with pytest.raises(ValueError, match="2 times"):
        Replaced("f", "twice", "raise", "pass", "").apply(source)


@pytest.mark.long
@pytest.mark.timeout(PLAYED_MAX_S)
def test_the_default_tier_misses_nearly_all_and_the_long_tier_every_one() -> None:
    done = subprocess.run(
        (sys.executable, "-m", "tests.mutants"), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
