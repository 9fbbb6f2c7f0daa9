"""Whole clusters of cores in situations that have a name: idle, slow, dead leaders, power cuts, joiners."""

from __future__ import annotations

import pytest

from consensus.chain.genesis import ChainSettings
from tests.sim.core_cluster import Cluster, Links

DELAY_MS = 10


def even(cluster, delay_ms=DELAY_MS):
    """Every message takes the same time, so that delays can be counted; all have asked for their last messages (R33)."""
    cluster.links = Links(delay_min=delay_ms, delay_max=delay_ms)
    cluster.execution_ms = 0.0
    cluster.start()
    cluster.run(2 * delay_ms + 1)
    return cluster


def finality_ms(cluster, txid, since):
    return [node.finalized_at_ms[txid] - since for node in cluster.nodes if node.is_up]


@pytest.mark.parametrize("warm_rounds", [0, 1, 2, 3])
def test_a_lone_transaction_on_an_idle_network_is_final_after_four_delays(warm_rounds):
    """Proposal, votes, empty child, votes; the next leader proposes at once on the QC that it completes itself."""
    cluster = even(Cluster(4))
    for _ in range(warm_rounds):
        cluster.submit()
        cluster.run(1_000)
    since, txid = cluster.clock, cluster.submit()
    assert cluster.run(1_000, lambda: cluster.all_final([txid]))
    assert max(finality_ms(cluster, txid, since)) < 5 * DELAY_MS
    assert min(finality_ms(cluster, txid, since)) >= 4 * DELAY_MS


def test_an_idle_network_is_silent_but_for_one_round_a_heartbeat():
    cluster = even(Cluster(4))
    cluster.submit()
    cluster.run(2_000)
    before = cluster.messages
    cluster.run(20_000)
    assert cluster.messages == before
    cluster.run(60_000)
    assert 0 < cluster.messages - before <= 60


def test_a_transaction_that_only_one_node_has_is_final_soon():
    cluster = even(Cluster(4))
    txid = cluster.submit([0])
    assert cluster.run(3_000, lambda: cluster.all_final([txid]))


@pytest.mark.parametrize("delay_ms", [600, 1_000, 1_500])
def test_constant_delays_above_the_base_timeout_do_not_stop_finality(delay_ms):
    """Counting lost rounds from the highest QC would never let two consecutive QCs fit here."""
    cluster = even(Cluster(4), delay_ms)
    txid = cluster.submit()
    assert cluster.run(120_000, lambda: cluster.all_final([txid]))


@pytest.mark.parametrize("delay_ms", [260, 400])
def test_over_long_links_rounds_are_given_up_only_until_the_distance_is_known(delay_ms):
    """A call is passed on, proposed and voted for later than the base timeout."""
    cluster, messages = even(Cluster(4), delay_ms), []
    for _ in range(16):
        before, txid = cluster.messages, cluster.submit([0])
        assert cluster.run_until_final(60_000, txid)
        cluster.run(2_000)
        messages.append(cluster.messages - before)
    assert messages[0] > 2 * messages[-1]
    assert set(messages[8:]) == {messages[-1]}


def test_a_dead_leader_costs_half_a_second_once_and_then_a_quarter_of_it():
    cluster = even(Cluster(4))
    cluster.nodes[2].crash()
    waits = []
    for _ in range(24):
        since, txid = cluster.clock, cluster.submit()
        assert cluster.run_until_final(5_000, txid)
        waits.append(max(finality_ms(cluster, txid, since)))
    assert max(waits) < 800
    assert max(waits[8:]) < 350


def test_two_dead_of_four_stop_the_chain_and_one_coming_back_moves_it():
    cluster = even(Cluster(4))
    cluster.nodes[1].crash()
    cluster.nodes[2].crash()
    txid = cluster.submit()
    cluster.run(60_000)
    assert all(node.height == 0 for node in cluster.nodes if node.is_up)
    cluster.nodes[1].start_if_down()
    assert cluster.run_until_final(10_000, txid)


def test_a_long_clean_partition_heals_within_a_second():
    cluster = even(Cluster(4))
    cluster.links.groups = [{0, 1}, {2, 3}]
    txid = cluster.submit()
    cluster.run(120_000)
    assert not any(txid in node.final_txids for node in cluster.nodes)
    cluster.links.groups = []
    assert cluster.run(1_000, lambda: cluster.all_final([txid]))


@pytest.mark.parametrize("seed", range(20))
def test_a_power_cut_of_the_whole_cluster_loses_nothing_that_was_final_anywhere(seed):
    """The stores lag behind their syncs: only the journals hold the newest final blocks."""
    cluster = Cluster(4, seed)
    cluster.start()
    final: set[bytes] = set()
    for _ in range(3):
        for _ in range(10):
            cluster.submit()
            cluster.run(cluster.random.uniform(5, 60))
        for node in cluster.nodes:
            final |= set(node.finalized_at_ms)
            node.crash()
        cluster.run(100)
        for node in cluster.nodes:
            node.start_if_down()
    after = cluster.submit()
    assert cluster.run(20_000, lambda: cluster.all_final([*final, after]))
    assert not cluster.halts


def test_a_node_that_was_away_for_long_catches_up_by_sync_and_votes_again():
    cluster = even(Cluster(4))
    cluster.nodes[3].crash()
    for _ in range(60):
        cluster.submit([0, 1, 2])
        cluster.run(400)
    cluster.nodes[3].start_if_down()
    cluster.reconnect(3)
    txid = cluster.submit()
    assert cluster.run(5_000, lambda: cluster.all_final([txid]))
    assert cluster.syncs > 0
    cluster.nodes[0].crash()
    txid = cluster.submit()
    assert cluster.run_until_final(5_000, txid)


def test_a_node_that_was_away_for_a_while_catches_up_by_fetching():
    cluster = even(Cluster(4))
    cluster.nodes[3].crash()
    for _ in range(12):
        cluster.submit([0, 1, 2])
        cluster.run(300)
    cluster.nodes[3].start_if_down()
    cluster.reconnect(3)
    txid = cluster.submit()
    assert cluster.run(5_000, lambda: cluster.all_final([txid]))
    assert cluster.syncs == 0


def test_a_follower_sees_finality_when_the_producers_do():
    cluster = even(Cluster(4, followers=1))
    since, txid = cluster.clock, cluster.submit()
    assert cluster.run(1_000, lambda: cluster.all_final([txid]))
    assert max(finality_ms(cluster, txid, since)) < 5 * DELAY_MS


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_other_sizes_of_the_schedule_finalize_too(count):
    cluster = even(Cluster(count))
    txids = [cluster.submit() for _ in range(5)]
    assert cluster.run(2_000, lambda: cluster.all_final(txids))


def test_interval_production_makes_a_block_every_interval():
    cluster = even(Cluster(4, settings=ChainSettings(production="interval:500")))
    cluster.run(10_050)
    assert 17 <= cluster.nodes[0].height <= 20


def test_blocks_per_turn_survives_a_dead_leader():
    cluster = even(Cluster(4, settings=ChainSettings(blocks_per_turn=3)))
    cluster.nodes[2].crash()
    for _ in range(8):
        txid = cluster.submit()
        assert cluster.run_until_final(10_000, txid)


def test_one_seed_is_one_history():
    def history(seed):
        cluster = Cluster(4, seed)
        cluster.links = Links(delay_min=5, delay_max=80, loss=0.1, duplicates=0.1)
        cluster.start()
        for _ in range(20):
            cluster.submit()
            cluster.run(100)
        return cluster.messages, cluster.clock, dict(cluster.violations.final)

    assert history(7) == history(7)
    assert history(7) != history(8)
