"""One seed is one history, bit for bit: in another process, under another hash seed, after other runs."""

from __future__ import annotations

import os
import subprocess
import sys

import msgspec

from network.sim.run import run_seed, run_with_history
from network.sim.sweep import plan_of

ROUNDS = 40
SEEDS = (2, 5)
_SCRIPT = """
import sys
from network.sim.run import run_seed
from network.sim.sweep import plan_of
for seed in map(int, sys.argv[2:]):
    print(run_seed(plan_of(seed, 4, int(sys.argv[1]), seed % 2)).trace)
"""


def traces_of_a_process(hash_seed: str, *seeds: int) -> list[str]:
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
    command = [sys.executable, "-c", _SCRIPT, str(ROUNDS), *map(str, seeds)]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=240)
    return answer.stdout.split()


def test_a_seed_gives_one_history_under_any_hash_seed_and_in_any_company() -> None:
    one = traces_of_a_process("1", *SEEDS)
    other = traces_of_a_process("2", *reversed(SEEDS))
    assert one == list(reversed(other))
    assert len(set(one)) == len(SEEDS)


def test_what_nodes_share_of_execution_changes_no_history() -> None:
    plan = plan_of(SEEDS[0], 4, ROUNDS, 0)
    apart = msgspec.structs.replace(plan, executes_apart=True)
    assert run_seed(plan).trace == run_seed(apart).trace


def test_an_observer_changes_nothing_of_what_it_sees() -> None:
    plan, seen = plan_of(SEEDS[0], 4, ROUNDS, 0), []
    watched, history = run_with_history(plan, listener=seen.append)
    alone, _ = run_with_history(plan)
    assert watched.trace == alone.trace
    assert seen == history.observations
