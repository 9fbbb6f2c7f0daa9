"""No call takes more than four times its budget of real memory: each program runs where there is no more.

What there is to run follows from the tables of the language, so that what is new there is tried by itself.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from contracts.vm.builtins.builtins_table import BUILTINS
from contracts.vm.builtins.methods import METHODS
from tests.effort import EFFORT, EFFORT_OF_ALL
from tests.hostile.peak_memory import FACTOR, programs

ROOT = Path(__file__).resolve().parents[2]
QUICK_PARTS = 250
LONG_PARTS = 80


def run_part(part: int, parts: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "tests.hostile.peak_memory", str(part), str(parts)]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def check(found: dict[str, Any]) -> None:
    assert found["failed"] == []
    assert found["ran"] > found["programs"] // 4, "most of them must do something"
    assert found["highest"][0][1] <= FACTOR, found["highest"]


def test_every_method_function_and_width_of_text_is_tried():
    text = "\n".join(program.source for program in programs())
    assert {name for name in METHODS if f".{name}(" not in text} == set()
    assert {name for name in BUILTINS if f" {name}(" not in text and f"({name}(" not in text} == set()


def test_a_sample_of_all_programs_has_room_enough():
    check(run_part(3, QUICK_PARTS))


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(min(LONG_PARTS, LONG_PARTS * EFFORT // EFFORT_OF_ALL)))
def test_programs_of_all_kinds_have_room_enough(part):
    check(run_part(part, LONG_PARTS))
