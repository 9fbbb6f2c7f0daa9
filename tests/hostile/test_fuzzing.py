"""Contracts made by chance: the machine foresees all of them, and two processes come to the same of each.

The long run takes 10,000 programs, or TEST_EFFORT times as many.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from network.lab.hostile.fuzzing import make_program, seed_sources
from network.lab.hostile.grammar import Grammar, mutate
from tests.effort import EFFORT

ROOT = Path(__file__).resolve().parents[2]
SHORT_COUNT = 2_500
LONG_COUNT = 2_000 * EFFORT
LONG_SEEDS = (101, 102, 103, 104, 105)


def start(seed: int, count: int, hash_seed: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
    command = [sys.executable, "-m", "network.lab.hostile.fuzzing", "--seed", str(seed), "--programs", str(count)]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


def found_by_two(seed: int, count: int) -> list[dict[str, Any]]:
    children = [start(seed, count, hash_seed) for hash_seed in ("3", "99")]
    return [json.loads(child.communicate()[0]) for child in children]


def check(first: dict[str, Any], second: dict[str, Any], count: int) -> None:
    assert first["faults"] == [] == second["faults"]
    assert first["digest"] == second["digest"]
    assert first["programs"] == count
    assert first["called"] > count // 5
    assert first["codes"]["OK"] > count // 20


def test_thousands_of_programs_do_nothing_that_was_not_foreseen():
    check(*found_by_two(1, SHORT_COUNT), SHORT_COUNT)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", LONG_SEEDS)
def test_many_more_programs_do_nothing_that_was_not_foreseen(seed):
    check(*found_by_two(seed, LONG_COUNT), LONG_COUNT)


def test_a_program_is_named_by_its_seed():
    sources = seed_sources()
    assert make_program("1/5", sources) == make_program("1/5", sources)
    assert make_program("1/5", sources) != make_program("1/6", sources)


def test_mutation_changes_a_source():
    chance = random.Random(4)
    source = Grammar(chance).source()
    assert any(mutate(source, chance, [source]) != source for _ in range(3))
