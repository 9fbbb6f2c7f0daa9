"""Four cores through delays, losses, partitions and crashes: they agree always, and live again once links heal."""

from __future__ import annotations

import pytest

from tests.sim.core_cluster import Cluster, Links

CHAOS_MS = 10_000
STEP_MS = 100
HEALED_MS = 60_000


def cause_trouble(cluster: Cluster) -> None:
    """Draw one fault: a crash, a partition, a change of the links, or nothing."""
    chance = cluster.random
    node = chance.choice(cluster.nodes)
    kind = chance.randrange(5)
    if kind == 0 and node.is_up:
        node.crash()
        cluster.at(cluster.clock + chance.uniform(100, 3_000), node.start_if_down)
    elif kind == 1:
        members = list(range(len(cluster.nodes)))
        chance.shuffle(members)
        cut = chance.randrange(1, len(members))
        cluster.links.groups = [set(members[:cut]), set(members[cut:])]
    elif kind == 2:
        cluster.links.groups = []
    elif kind == 3:
        cluster.links.delay_max = chance.choice([20, 50, 200, 600])
    else:
        cluster.links.loss = chance.choice([0.0, 0.05, 0.2])


def heal(cluster: Cluster) -> None:
    cluster.links = Links(delay_min=5, delay_max=50)
    cluster.crash_after_sync = 0.0
    for node in cluster.nodes:
        node.start_if_down()
        cluster.reconnect(node.number)


def live_through_chaos(seed: int, count: int = 4) -> Cluster:
    """Run one seed; the checkers in the harness assert on the way."""
    cluster = Cluster(count, seed)
    cluster.links = Links(delay_min=5, delay_max=100, loss=0.05, duplicates=0.1)
    cluster.crash_after_sync = 0.01
    cluster.start()
    txids: list[bytes] = []
    for step in range(CHAOS_MS // STEP_MS):
        if step % 4 == 0:
            cause_trouble(cluster)
        submitted_to = [cluster.random.randrange(count)]
        if cluster.nodes[submitted_to[0]].is_up:
            txids.append(cluster.submit(submitted_to))
        cluster.run(STEP_MS)
    heal(cluster)
    after = cluster.submit()
    assert cluster.run(HEALED_MS, lambda: cluster.all_final([after])), "not live after healing"
    assert not cluster.halts
    return cluster


@pytest.mark.parametrize("first_seed", range(0, 100, 10))
def test_four_cores_agree_through_chaos_and_are_live_after_it(first_seed):
    for seed in range(first_seed, first_seed + 10):
        cluster = live_through_chaos(seed)
        assert len(cluster.violations.final) > 1, seed
