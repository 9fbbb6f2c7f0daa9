"""Directed schedules: what random faults seldom hit, one at a time, with the whole production node.

Each is a class of failure that brought down other chains: records lost between sync and send, old files put back,
every node without power at once while stores lag, a full disk, a clock an hour off.
"""

from __future__ import annotations

import pytest

from network.sim.contract_workload import contract_turnover
from network.sim.history import (
    Acknowledged,
    BlockFinalized,
    Ended,
    History,
    NodeRestored,
    NodeStarted,
    NodeStopped,
    VoteSent,
)
from network.sim.plan import Fault, Plan
from network.sim.run import run_with_history
from node.p2p.wire import FrameKind
from node.peers.peers import Peers


def play(*faults: Fault, seed: int = 1, nodes: int = 4, rounds: int = 40) -> History:
    """Play these faults; nothing that is promised may break."""
    result, history = run_with_history(Plan(seed=seed, nodes=nodes, rounds=rounds, faults=faults))
    assert [str(violation) for violation in result.violations] == []
    return history


def votes_after(history: History, node: int, at_ms: float) -> list[VoteSent]:
    return [vote for vote in history.of(VoteSent) if vote.node == node and vote.at_ms > at_ms]


def starts_of(history: History, node: int) -> list[NodeStarted]:
    return [start for start in history.of(NodeStarted) if start.node == node]


@pytest.mark.parametrize("point", ["before-sync", "torn-sync", "after-sync", "mid-broadcast", "mid-commit"])
def test_each_node_in_turn_dies_at_the_same_point_and_takes_part_again(point: str) -> None:
    crashes = [
        Fault(kind="crash", at_ms=100 + 650 * node, for_ms=30 + 20 * node, node=node, point=point) for node in range(4)
    ]
    history = play(*crashes, rounds=160)
    stops = [stop.why for stop in history.of(NodeStopped)]
    assert len(stops) == 4
    assert stops.count(point) >= 3  # one may have been cut off after waiting for the point in vain
    last = history.of(NodeStopped)[-1].at_ms
    assert all(votes_after(history, node, last) for node in range(4))


@pytest.mark.parametrize("point", ["before-sync", "torn-sync", "after-sync"])
def test_a_node_that_dies_again_and_again_around_its_syncs_never_contradicts_itself(point: str) -> None:
    crashes = [Fault(kind="crash", at_ms=100 + 60 * n, for_ms=5, node=2, point=point) for n in range(10)]
    history = play(*crashes, seed=4)
    assert len(starts_of(history, 2)) >= 8


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_when_all_lose_power_while_their_stores_lag_nothing_that_a_client_was_told_is_lost(seed: int) -> None:
    lags = [Fault(kind="slow-store", at_ms=50, for_ms=900, node=node, amount=400 + 300 * node) for node in range(4)]
    cuts = [Fault(kind="power-cut", at_ms=at_ms, for_ms=60) for at_ms in (400, 700, 800)]
    history = play(*lags, *cuts, seed=seed)
    assert len(history.of(NodeStopped)) >= 10
    told = max(item.height for item in history.of(Acknowledged))
    assert history.of(Ended)[-1].settled
    assert min(history.of(Ended)[-1].heights) >= told


@pytest.mark.parametrize("what", ["journal", "machine"])
def test_a_node_that_comes_back_with_an_old_disk_waits_until_it_cannot_contradict_itself(what: str) -> None:
    history = play(Fault(kind="old-disk", at_ms=200, for_ms=40, node=1, amount=300, point=what), rounds=80)
    restored = history.of(NodeRestored)[0].at_ms
    assert [item.node for item in history.of(NodeRestored)] == [1]
    assert votes_after(history, 1, restored)


def test_a_node_whose_disk_is_full_says_nothing_and_goes_on_by_itself_once_there_is_room() -> None:
    history = play(Fault(kind="full-disk", at_ms=200, for_ms=600, node=3), rounds=80)
    silent = [vote for vote in votes_after(history, 3, 215) if vote.at_ms < 800]
    assert silent == []
    assert votes_after(history, 3, 800)
    assert len(starts_of(history, 3)) == 1


def test_two_halves_finalize_nothing_apart_and_go_on_together() -> None:
    history = play(Fault(kind="partition", at_ms=300, for_ms=1_000, groups=((0, 1), (2, 3))))
    between = [block for block in history.of(BlockFinalized) if 400 < block.at_ms < 1_300]
    after = [block for block in history.of(BlockFinalized) if block.at_ms > 1_300]
    assert between == []
    assert {block.node for block in after} == {0, 1, 2, 3}


def test_three_of_four_go_on_without_the_one_that_is_cut_off_and_it_catches_up() -> None:
    history = play(Fault(kind="partition", at_ms=300, for_ms=2_500, groups=((0,), (1, 2, 3))), rounds=120)
    apart = {block.node for block in history.of(BlockFinalized) if 400 < block.at_ms < 2_700}
    assert apart == {1, 2, 3}
    assert len(set(history.of(Ended)[-1].heights)) == 1


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_an_hour_off_delays_nobody_but_its_node(hours: int) -> None:
    history = play(Fault(kind="skew", at_ms=200, for_ms=1_500, node=0, amount=hours * 3_600_000), rounds=80)
    assert any(800 < block.at_ms < 1_700 for block in history.of(BlockFinalized))


def test_a_node_that_was_paused_for_longer_than_the_timeout_goes_on_where_the_others_are() -> None:
    history = play(Fault(kind="pause", at_ms=250, for_ms=2_000, node=1), rounds=100)
    assert votes_after(history, 1, 2_300)


def test_contracts_are_upgraded_disabled_and_rolled_back_while_nodes_die_and_are_cut_off() -> None:
    """Every node executes for itself, migrations too; all end with one state, and every call that was due succeeded."""
    faults = (
        Fault(kind="crash", at_ms=900, for_ms=1_500, node=3, point="mid-commit"),
        Fault(kind="partition", at_ms=3_500, for_ms=900, groups=((0,), (1, 2, 3))),
        Fault(kind="crash", at_ms=6_000, for_ms=300, node=1, point="after-sync"),
    )
    plan = Plan(seed=5, rounds=340, governance="contracts", executes_apart=True, faults=faults)
    result, history = run_with_history(plan)
    assert [str(violation) for violation in result.violations] == []
    done = {told.txid for told in history.of(Acknowledged) if told.ok}
    for number in range(2):
        batches = contract_turnover(plan.size, number)
        assert {call.transaction.txid for batch in batches for call in batch} <= done, number


def test_a_link_that_carries_one_way_only_stops_nobody() -> None:
    deaf = [Fault(kind="one-way", at_ms=200, for_ms=1_500, node=node, peer=(node + 1) % 4) for node in range(2)]
    history = play(*deaf)
    assert any(500 < block.at_ms < 1_600 for block in history.of(BlockFinalized))


def test_nodes_that_answer_each_other_without_end_are_a_violation_and_the_run_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    take = Peers.peer_frame

    def answer_twice(self: Peers, peer: str, kind: FrameKind, payload: bytes) -> None:
        take(self, peer, kind, payload)
        if kind is FrameKind.HEIGHT:
            for _ in range(2):
                self._tell_height(peer)

    monkeypatch.setattr(Peers, "peer_frame", answer_twice)
    result, _ = run_with_history(Plan(seed=1, nodes=4, rounds=40))
    assert any("storm" in violation.text for violation in result.violations if violation.checker == "code_faults")
