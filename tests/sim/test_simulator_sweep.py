"""Many seeds: whatever goes wrong, no promise is broken, with and without dishonest nodes."""

from __future__ import annotations

import pytest

from network.sim.run import run_seed
from network.sim.sweep import plan_of, sweep
from tests.effort import EFFORT


@pytest.mark.parametrize("seed", range(1, 9))
def test_four_nodes_keep_every_promise_under_the_faults_of_a_seed(seed: int) -> None:
    result = run_seed(plan_of(seed, 4, 60, seed % 2))
    assert result.violations == ()
    assert result.rounds >= 60
    assert result.acknowledged > 0


@pytest.mark.parametrize("seed", [223, 236])
def test_a_clip_that_has_just_expired_in_the_end_is_not_taken_for_lost(seed: int) -> None:
    assert run_seed(plan_of(seed, 4, 10, seed % 2)).violations == ()


def test_seven_nodes_with_two_dishonest_ones_keep_every_promise() -> None:
    assert run_seed(plan_of(11, 7, 40, 2)).violations == ()


def test_a_lone_node_is_a_network_that_keeps_its_promises() -> None:
    assert run_seed(plan_of(3, 1, 40, 0)).violations == ()


@pytest.mark.long
@pytest.mark.timeout(1_800)
@pytest.mark.parametrize(("nodes", "byzantine", "seeds"), [(4, 0, 30), (4, 1, 30), (7, 2, 4), (10, 3, 2)])
def test_many_seeds_keep_every_promise(nodes: int, byzantine: int, seeds: int) -> None:
    total = sweep([plan_of(seed, nodes, 200, byzantine) for seed in range(1_000, 1_000 + seeds * EFFORT)])
    assert [str(violation) for result in total.failed for violation in result.violations] == []
    assert total.seeds == seeds * EFFORT


def test_workers_play_the_same_histories_as_one_process_does() -> None:
    """A worker is sent its plans; crashes now, which are the default, are among them."""
    plans = [plan_of(seed, 4, 10, seed % 2) for seed in range(40, 60)]
    assert any(fault.kind == "crash" and fault.point == "now" for plan in plans for fault in plan.faults)
    alone, shared = sweep(plans, workers=1), sweep(plans, workers=2)
    assert alone.traces == shared.traces
    assert alone.trace == shared.trace
    assert len(set(alone.traces.values())) == len(plans)
