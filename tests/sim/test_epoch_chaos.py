"""R21 to R25 through delays, losses, partitions and crashes, while the producers change: one chain, and it goes on."""

from __future__ import annotations

import pytest

from tests.sim.core_cluster import Cluster, Links
from tests.sim.lying_node import LyingNode
from tests.sim.test_core_chaos import STEP_MS, cause_trouble, heal

STEPS = 120
CHANGE_EVERY_STEPS = 20
HEALED_MS = 90_000
NODES = 7

GROW_AND_SHRINK = [[0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6], [3, 4, 5, 6]]


def draw_producers(cluster: Cluster) -> list[int]:
    """Draw the next producers: any number of any nodes, in any order."""
    count = cluster.random.choice([1, 3, 4, 4, 5, 7])
    return cluster.random.sample(range(NODES), count)


def live_through_changes(seed: int, plan: list[list[int]] | None = None, kinds=None) -> Cluster:
    """Run one seed with a change of producers every two seconds; the checkers in the harness assert on the way."""
    cluster = Cluster(4, seed, candidates=NODES - 4, kinds=kinds)
    cluster.links = Links(delay_min=5, delay_max=100, loss=0.05, duplicates=0.1)
    cluster.crash_after_sync = 0.01
    cluster.start()
    for step in range(STEPS):
        if step % 5 == 0:
            cause_trouble(cluster)
        if step % CHANGE_EVERY_STEPS == 10:
            place = step // CHANGE_EVERY_STEPS
            cluster.change(draw_producers(cluster) if plan is None else plan[place % len(plan)])
        cluster.submit([cluster.random.randrange(NODES)])
        cluster.run(STEP_MS)
    heal(cluster)
    return cluster


def assert_alive(cluster: Cluster) -> None:
    after = cluster.submit()

    honest = [node for node in cluster.nodes if node.is_up and not isinstance(node, LyingNode)]

    def is_alive() -> bool:
        return len({node.epoch for node in honest}) == 1 and all(after in node.final_txids for node in honest)

    assert cluster.run(HEALED_MS, is_alive), "not live after healing"
    assert not cluster.halts


FIRST_SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (10, 20, 30))]


@pytest.mark.parametrize("first_seed", FIRST_SEEDS)
def test_any_nodes_may_follow_any_others(first_seed):
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed)
        assert_alive(cluster)


@pytest.mark.parametrize("first_seed", FIRST_SEEDS)
def test_producers_grow_from_four_to_seven_and_shrink_again(first_seed):
    epochs = 0
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed, GROW_AND_SHRINK)
        assert_alive(cluster)
        epochs += cluster.nodes[0].epoch.number
    assert epochs > 10


@pytest.mark.parametrize("first_seed", FIRST_SEEDS)
def test_one_of_the_old_and_the_new_producers_lies(first_seed):
    """Where only the liar is in both sets, nobody honest of the old one is there to begin the new epoch."""
    plan = [[0, 1, 2, 3], [3, 4, 5, 6], [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3]]
    found = 0
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed, plan, kinds={3: LyingNode})
        assert_alive(cluster)
        found += len(cluster.evidence)
        assert {evidence.producer for _, evidence in cluster.evidence} <= {cluster.keys[3].public_key}
    assert found > 0


@pytest.mark.parametrize("first_seed", [0])
def test_two_of_seven_are_down_for_good(first_seed):
    """All seven are producers by then, and only their order changes still."""
    seven = GROW_AND_SHRINK[1]
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed, [seven, seven[::-1]])
        assert_alive(cluster)
        for node in cluster.random.sample(cluster.nodes, 2):
            node.crash()
        assert_alive(cluster)
        assert len(cluster.nodes[0].epoch.producers) == 7
