"""Contracts made to do harm are refused or stopped, each in the way that is written beside it, and alike everywhere.

The corpus runs in two processes with little memory and different hash seeds: what one of them sees the other must see.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from network.lab.hostile.families import CORPUS, FAMILIES

ROOT = Path(__file__).resolve().parents[2]
GROWTH_MAX_KIB = 96 * 1024
GROWTH_AGAIN_MAX_KIB = 12 * 1024
CALL_MAX_S = 3.0


def start(seed: str, *more: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    command = [sys.executable, "-m", "network.lab.hostile.child", *more]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def runs() -> list[dict[str, Any]]:
    """What two processes say of the corpus."""
    children = [start("1", "--again"), start("77")]
    answers = [child.communicate()[0] for child in children]
    assert [child.returncode for child in children] == [0, 0], "the machine failed, or its memory ran out"
    return [json.loads(answer) for answer in answers]


def test_the_corpus_is_large_and_each_program_has_its_own_name():
    assert len(CORPUS) >= 120
    assert len({program.name for program in CORPUS}) == len(CORPUS)
    assert all(len(programs) >= 20 for programs in FAMILIES.values())


def test_every_program_comes_to_what_it_must(runs):
    assert runs[0]["misfits"] == []
    assert [finding["name"] for finding in runs[0]["findings"]] == [program.name for program in CORPUS]


def test_two_processes_see_the_same_of_every_program(runs):
    assert runs[0]["findings"] == runs[1]["findings"]


def test_memory_stays_flat(runs):
    """All programs together take little, and those who run them again take no more: nothing of a program remains."""
    assert max(run["peak_kib"] - run["started_kib"] for run in runs) < GROWTH_MAX_KIB
    first, *again = runs[0]["peaks_kib"]
    assert len(again) == 2
    assert max(again) - first < GROWTH_AGAIN_MAX_KIB


def test_no_program_holds_the_machine_up(runs):
    slow = {name: seconds for name, seconds in runs[0]["seconds"].items() if seconds > CALL_MAX_S}
    assert slow == {}
