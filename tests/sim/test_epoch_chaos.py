"""R21 to R25 through delays, losses, partitions and crashes, while the producers change: one chain, and it goes on."""

from __future__ import annotations

import pytest

from tests.sim.core_cluster import Cluster, Links
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

    def is_alive() -> bool:
        epochs = {node.epoch for node in cluster.nodes if node.is_up}
        return len(epochs) == 1 and cluster.final_where_up(after)

    assert cluster.run(HEALED_MS, is_alive), "not live after healing"
    assert not cluster.halts


@pytest.mark.parametrize("first_seed", range(0, 60, 10))
def test_any_nodes_may_follow_any_others(first_seed):
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed)
        assert_alive(cluster)


@pytest.mark.parametrize("first_seed", range(0, 60, 10))
def test_producers_grow_from_four_to_seven_and_shrink_again(first_seed):
    epochs = 0
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_changes(seed, GROW_AND_SHRINK)
        assert_alive(cluster)
        epochs += cluster.nodes[0].epoch.number
    assert epochs > 10
