"""Custodians join, leave and are lost under load, with erasures in flight: nothing is lost, and nothing erased is kept."""

from __future__ import annotations

import msgspec
import pytest

from network.sim.history import Acknowledged, ChainAudit, ClipKept, ClipTaken, CustodyAudit, Ended, History
from network.sim.plan import CUSTODY_NODES_COUNT, make_custody_plan
from network.sim.run import run_with_history
from network.sim.sweep import sweep
from network.sim.workload import COPIES_COUNT, custody_turnover
from tests.effort import EFFORT

SEEDS_COUNT = 4 * EFFORT
ROUNDS = 60
LEFT, LOST = 5, 4
"""The nodes that leave and die in seed 2."""


def play(seed: int, *, is_calm: bool = False) -> History:
    """Play the custodians of a seed; nothing that is promised may break."""
    plan = make_custody_plan(seed, rounds=ROUNDS)
    result, history = run_with_history(msgspec.structs.replace(plan, faults=()) if is_calm else plan)
    assert [str(violation) for violation in result.violations] == []
    return history


@pytest.fixture(scope="module")
def calm() -> History:
    """A network of which only custodians come and go."""
    return play(2, is_calm=True)


def test_one_custodian_leaves_one_is_lost_and_two_join(calm: History) -> None:
    done = {told.txid for told in calm.of(Acknowledged) if told.ok}
    calls = [call for batch in custody_turnover(make_custody_plan(2).size, 2) for call in batch]
    assert {call.transaction.txid for call in calls} <= done
    assert calm.lost == {LOST}
    [chain] = calm.of(ChainAudit)
    assert chain.members == tuple(sorted(set(range(CUSTODY_NODES_COUNT)) - {LEFT, LOST}))
    assert calm.of(Ended)[-1].settled


def test_who_joins_fetches_its_share_and_every_live_clip_has_its_copies(calm: History) -> None:
    [chain] = calm.of(ChainAudit)
    taken = {(item.node, item.record_id) for item in calm.of(ClipTaken)}
    fetched = [item for item in calm.of(ClipKept) if (item.node, item.record_id) not in taken]
    assert {item.node for item in fetched} > {CUSTODY_NODES_COUNT - 1}
    held = {audit.node: set(audit.confirmed) for audit in calm.of(CustodyAudit)}
    assert len(chain.keepers) > 10
    for record_id, keepers in chain.keepers:
        assert len(keepers) == chain.copies >= COPIES_COUNT
        assert all(record_id in held[node] for node in keepers)


def test_what_was_erased_is_at_nobody_not_even_at_who_left_and_all_that_had_it_confirmed(calm: History) -> None:
    [chain] = calm.of(ChainAudit)
    audits = {audit.node: audit for audit in calm.of(CustodyAudit)}
    assert LEFT in audits
    assert LOST not in audits
    erased = {record_id for audit in audits.values() for record_id in audit.chain_erased}
    assert len(erased) > 10
    assert all(not erased & {*audit.confirmed, *audit.missing} and not audit.keys_left for audit in audits.values())
    assert any(item.node == LEFT and item.record_id in erased for item in calm.of(ClipKept))
    confirming = [set(nodes) for _, _, nodes in chain.erasures]
    assert all({0, 1, 2, 3} <= nodes for nodes in confirming)
    assert any(LEFT in nodes for nodes in confirming)


@pytest.mark.parametrize("seed", [1, 4])
def test_custodians_come_and_go_under_the_faults_of_a_seed(seed: int) -> None:
    history = play(seed)
    assert len(history.lost) == 1


@pytest.mark.long
@pytest.mark.timeout(3_600)
def test_many_seeds_of_custodians_keep_every_promise() -> None:
    total = sweep([make_custody_plan(seed, rounds=ROUNDS) for seed in range(100, 100 + SEEDS_COUNT)])
    assert [str(violation) for result in total.failed for violation in result.violations] == []
    assert total.seeds == SEEDS_COUNT
