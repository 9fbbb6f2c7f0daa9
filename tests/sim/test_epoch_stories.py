"""Changes of producers and settings that have a name: growing, replacing, laggards, power cuts, one alone (R21 to R27)."""

from __future__ import annotations

import itertools

import pytest

from consensus.chain.genesis import ChainSettings
from tests.sim.core_cluster import Cluster
from tests.sim.test_core_stories import DELAY_MS, even

FOUR, SEVEN = [0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6]


def in_epoch(cluster, number):
    """Tell whether every node that is up is in this epoch."""
    return all(node.epoch.number == number for node in cluster.nodes if node.is_up)


def changed(cluster, number, duration_ms=20_000):
    return cluster.run(duration_ms, lambda: in_epoch(cluster, number))


def producers(cluster):
    return [cluster.number_of(key) for key in cluster.nodes[0].epoch.producers]


def test_a_network_grows_from_four_to_seven_and_shrinks_again():
    cluster = even(Cluster(4, candidates=3))
    for number, members in enumerate((SEVEN, FOUR, [6, 5, 4, 3]), start=1):
        cluster.change(members)
        assert changed(cluster, number)
        txid = cluster.submit()
        assert cluster.run_until_final(2_000, txid)
        assert producers(cluster) == members
        assert [cluster.nodes[member].core.index for member in members] == list(range(len(members)))


def test_a_network_grows_to_ten():
    cluster = even(Cluster(4, candidates=6))
    cluster.change(SEVEN)
    assert changed(cluster, 1)
    cluster.change(list(range(10)))
    assert changed(cluster, 2)
    assert cluster.nodes[0].core.schedule.quorum == 7
    assert cluster.run_until_final(2_000, cluster.submit())


def test_a_change_under_load_costs_finality_less_than_one_timeout():
    """Closing block, its votes, a sync of every store (up to 400 ms here), and the new producers greet each other."""
    cluster = even(Cluster(4, candidates=3))
    cluster.run(200)
    for step in range(300):
        if step == 100:
            cluster.change(SEVEN)
        cluster.submit()
        cluster.run(10)
    times = sorted(set(cluster.nodes[0].finalized_at_ms.values()))
    assert changed(cluster, 1)
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 500


def test_all_producers_are_replaced_at_once():
    cluster = even(Cluster(4, candidates=4))
    cluster.change([4, 5, 6, 7])
    assert changed(cluster, 1)
    for old in range(4):
        cluster.nodes[old].crash()
    assert cluster.run_until_final(2_000, cluster.submit())


@pytest.mark.parametrize("down", [[6], [3], [5, 6]], ids=str)
def test_the_network_grows_while_as_many_are_down_as_it_tolerates(down):
    """Of the old four one may be down, of the new seven two."""
    cluster = even(Cluster(4, candidates=3))
    for number in down:
        cluster.nodes[number].crash()
    cluster.change(SEVEN)
    assert changed(cluster, 1)
    assert cluster.run_until_final(10_000, cluster.submit())
    for number in down:
        cluster.nodes[number].start_if_down()
    assert changed(cluster, 1)
    assert cluster.run_until_final(10_000, cluster.submit())


def test_too_many_new_producers_down_stop_the_chain_until_one_comes():
    cluster = even(Cluster(4, candidates=3))
    for number in (4, 5, 6):
        cluster.nodes[number].crash()
    cluster.change(SEVEN)
    assert changed(cluster, 1)
    txid = cluster.submit()
    assert not cluster.run_until_final(60_000, txid)
    cluster.nodes[5].start_if_down()
    assert cluster.run_until_final(20_000, txid)


def test_a_laggard_of_the_epoch_before_is_told_how_it_ended():
    """Node 3 hears nothing of the change; its own timeout, in its old epoch, is answered with the proof."""
    cluster = even(Cluster(4, candidates=3))
    cluster.links.groups = [{3}, {0, 1, 2, 4, 5, 6}]
    cluster.change(SEVEN, nodes=[0, 1, 2])
    cluster.run(3_000)
    assert cluster.nodes[3].epoch.number == 0
    assert cluster.nodes[0].epoch.number == 1
    cluster.links.groups = []
    cluster.nodes[3].submit(*cluster.nodes[0].mempool.values())
    assert changed(cluster, 1, 2_000)
    txid = cluster.submit()
    assert cluster.run_until_final(2_000, txid)


def test_a_laggard_over_several_epochs_catches_up_one_by_one():
    cluster = even(Cluster(4, candidates=4))
    cluster.nodes[3].crash()
    for number, members in enumerate(([0, 1, 2, 4], [0, 1, 4, 5], [0, 4, 5, 6], [4, 5, 6, 7]), start=1):
        cluster.change(members)
        assert changed(cluster, number)
        assert cluster.run_until_final(5_000, cluster.submit([4]))
    cluster.nodes[3].start_if_down()
    assert changed(cluster, 4, 5_000)
    assert cluster.run_until_final(5_000, cluster.submit())


def test_a_new_producer_that_starts_late_is_told_until_it_speaks():
    cluster = even(Cluster(4, candidates=1))
    cluster.nodes[4].crash()
    cluster.change([1, 2, 3, 4])
    cluster.run(10_000)
    late = cluster.nodes[4]
    late.start()  # without any connection that comes up: only the announcements reach it
    assert cluster.run(2_000, lambda: late.epoch.number == 1)
    cluster.nodes[1].crash()
    assert cluster.run_until_final(10_000, cluster.submit())


def power_cut_when(cluster, condition, duration_ms=20_000):
    """Take everybody's power at the first moment at which the condition holds; give it back."""
    assert cluster.run(duration_ms, condition)
    for node in cluster.nodes:
        node.crash()
    cluster.run(100)
    for node in cluster.nodes:
        node.start()
    for node in cluster.nodes:
        cluster.reconnect(node.number)


def test_power_is_lost_right_before_any_store_has_the_boundary():
    """The boundary is final, and somebody may know it, but only journals have it."""
    cluster = even(Cluster(4, candidates=3))
    boundary = cluster.change(SEVEN)
    power_cut_when(cluster, lambda: any(node.store.unsynced and node.core.has_ended for node in cluster.nodes))
    assert not any(node.store.epoch.number for node in cluster.nodes)
    assert changed(cluster, 1)
    assert cluster.run_until_final(10_000, boundary)
    assert cluster.run_until_final(10_000, cluster.submit())


def test_power_is_lost_right_after_one_store_or_all_have_the_boundary():
    cluster = even(Cluster(4, candidates=3))
    cluster.change(SEVEN)
    power_cut_when(cluster, lambda: any(node.store.epoch.number for node in cluster.nodes))
    assert 0 < sum(node.store.epoch.number for node in cluster.nodes) < 7
    assert changed(cluster, 1)
    assert cluster.run_until_final(10_000, cluster.submit())
    cluster = even(Cluster(4, candidates=3))
    cluster.change(SEVEN)
    power_cut_when(cluster, lambda: in_epoch(cluster, 1))
    assert in_epoch(cluster, 1)
    assert cluster.run_until_final(10_000, cluster.submit())


def test_one_alone_becomes_four_and_one_again():
    cluster = even(Cluster(1, candidates=3))
    for number, members in enumerate((FOUR, [2], [2]), start=1):
        cluster.change(members)
        assert changed(cluster, number)
        assert cluster.run_until_final(5_000, cluster.submit())


def test_settings_change_as_producers_do():
    cluster = even(Cluster(4))
    slower = ChainSettings(base_timeout_ms=2_000, timeout_cap_ms=4_000)
    cluster.change(FOUR, settings=slower)
    assert changed(cluster, 1)
    assert cluster.nodes[0].epoch.settings == slower
    cluster.nodes[2].crash()
    waits = []
    for _ in range(4):
        since = cluster.clock
        assert cluster.run_until_final(20_000, cluster.submit())
        waits.append(cluster.clock - since)
    assert 2_000 < max(waits) < 4_000


def test_a_leaderless_seat_votes_but_its_absence_costs_no_round():
    cluster = even(Cluster(4))
    cluster.change(FOUR, leaderless=(2,))
    assert changed(cluster, 1)
    cluster.nodes[2].crash()
    for _ in range(8):
        since, txid = cluster.clock, cluster.submit()
        assert cluster.run_until_final(5_000, txid)
        assert cluster.clock - since < 6 * DELAY_MS
    cluster.nodes[2].start_if_down()
    cluster.nodes[1].crash()
    assert cluster.run_until_final(10_000, cluster.submit())


def test_changes_in_one_block_make_one_epoch_and_those_that_follow_at_once_are_all_made():
    cluster = even(Cluster(4, candidates=3))
    cluster.change([1, 2, 3, 4])
    cluster.change(SEVEN)
    assert changed(cluster, 1)
    cluster.run(2_000)
    assert in_epoch(cluster, 1)
    assert producers(cluster) == SEVEN
    cluster = even(Cluster(4, candidates=3))
    for step in range(8):
        cluster.change(SEVEN if step % 2 else FOUR)
        cluster.run(30)
    cluster.run(10_000)
    assert len({node.epoch for node in cluster.nodes}) == 1
    assert cluster.nodes[0].epoch.number > 2
    assert cluster.run_until_final(2_000, cluster.submit())


def test_an_idle_network_falls_silent_again_after_a_change():
    cluster = even(Cluster(4, candidates=3))
    cluster.change(SEVEN)
    assert changed(cluster, 1)
    cluster.run(2_000)
    before = cluster.messages
    cluster.run(20_000)
    assert cluster.messages == before
