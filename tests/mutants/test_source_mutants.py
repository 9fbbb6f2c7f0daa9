"""Mistakes that are made in the product on purpose fail a test of the default tier."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.mutant import DroppedCheck, Kind, Mutant, Replaced, apply_to
from tests.mutants.playground import DEFAULT, PACKAGES, Outcome, Playground
from tests.mutants.table import MUTANTS, read_mutants

ROOT = Path(__file__).resolve().parents[2]
PLAYED_MAX_S = 3_000


def test_there_are_enough_of_them_and_each_has_its_own_name() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS) >= 64
    assert all(sum(mutant.kind == kind for mutant in MUTANTS) >= 3 for kind in Kind)


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
        changed = DroppedCheck(Kind.PROOFS, "f", "X", number, "").apply(source)
        assert [other in changed for other in kept] == [other != text for other in kept]
    assert "require(True," in DroppedCheck(Kind.PROOFS, "f", "X", 2, "").apply(source)
    with pytest.raises(ValueError, match="3 such checks"):
        DroppedCheck(Kind.PROOFS, "f", "X", 3, "").apply(source)
    with pytest.raises(ValueError, match="2 times"):
        Replaced(Kind.PROOFS, "f", "twice", "raise", "pass", "").apply(source)


def test_a_table_tells_dropped_checks_and_replaced_texts() -> None:
    table = "@ proofs f.py tests/a.py\n@ tests/b.py\nX 0 2\none line goes\n-old\npart of a line\n-a\n-b\n+\n"
    proofs, killed_by = (Kind.PROOFS, "f.py"), "tests/a.py tests/b.py"
    assert list(read_mutants(table)) == [
        DroppedCheck(*proofs, "X", 0, killed_by),
        DroppedCheck(*proofs, "X", 2, killed_by),
        Replaced(*proofs, "one line goes", "old\n", "", killed_by),
        Replaced(*proofs, "part of a line", "a\nb", "", killed_by),
    ]
    with pytest.raises(ValueError, match="no mutant: a name alone"):
        list(read_mutants(table + "a name alone\n"))


@pytest.mark.long
@pytest.mark.parametrize("options", [(), ("-I",)], ids=["as tests do", "isolated"])
def test_what_a_test_starts_imports_the_copy(tmp_path: Path, options: tuple[str, ...]) -> None:
    playground = Playground(tmp_path)
    assert playground.find_packages(*options) == [playground.tree / name for name in PACKAGES]


@pytest.mark.long
def test_a_mutant_is_killed_by_a_test_that_sees_it_and_by_no_other_and_is_taken_back(tmp_path: Path) -> None:
    playground = Playground(tmp_path)
    file, seen_by, other = "consensus/primitives/merkle.py", "test_merkle.py", "test_exit_codes.py"
    original = (playground.tree / file).read_text(encoding="utf-8")

    def play(tests: str) -> Outcome:
        changed = Replaced(Kind.PROOFS, file, "n", "index ^ 1 < width", "False", f"tests/unit/consensus/{tests}")
        return playground.play(changed, (DEFAULT,))

    assert [play(tests).killed_in for tests in (seen_by, other, seen_by)] == [DEFAULT, "", DEFAULT]
    assert (playground.tree / file).read_text(encoding="utf-8") == original
    assert playground.fails_unchanged([f"tests/unit/consensus/{seen_by}"]) == ""


@pytest.mark.long
@pytest.mark.timeout(PLAYED_MAX_S)
def test_the_default_tier_kills_nearly_all_and_the_long_tier_every_one() -> None:
    done = subprocess.run(
        (sys.executable, "-m", "tests.mutants"), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
