"""The cost model: work takes time of each node's core, so that a member who floods the others shows in virtual time."""

from __future__ import annotations

import msgspec
import pytest

from network.sim.history import BlockFinalized, Flooded, PeerCutOff
from network.sim.plan import FLOODS, Fault, Plan, make_flood_plan
from network.sim.run import run_seed, run_with_history

ROUNDS = 120


def flood_plan(kind: str, *, seed: int = 1) -> Plan:
    flood = Fault(kind="flood", at_ms=1_200, for_ms=1_200, node=3, point=kind, amount=FLOODS[kind][1])
    return Plan(seed=seed, rounds=ROUNDS, cpu=True, faults=(flood,))


@pytest.mark.parametrize("kind", sorted(FLOODS))
def test_calls_become_final_about_as_fast_while_a_member_floods(kind: str) -> None:
    result, history = run_with_history(flood_plan(kind))
    assert [str(violation) for violation in result.violations] == []
    assert [(flood.node, flood.text) for flood in history.of(Flooded)] == [(3, kind)]


def test_a_member_that_forges_is_cut_off_by_each_and_for_longer_the_second_time() -> None:
    flood = msgspec.structs.replace(flood_plan("forged-transactions").faults[0], for_ms=4_000)
    history = run_with_history(Plan(seed=1, rounds=250, cpu=True, faults=(flood,)))[1]
    cuts = [cut for cut in history.of(PeerCutOff) if cut.peer == 3]
    assert {cut.code for cut in cuts} == {"SIGNATURE_INVALID"}
    for node in range(3):
        first, second = (cut.at_ms for cut in cuts if cut.node == node)
        assert 2_000 <= second - first < 4_000


def test_work_takes_time_and_a_flood_costs_the_others_few_rounds() -> None:
    plan = flood_plan("expired-transactions")
    flooded = run_seed(plan)
    free = run_seed(msgspec.structs.replace(plan, cpu=False))
    quiet = run_seed(msgspec.structs.replace(plan, faults=()))
    assert free.rounds > max(quiet.rounds, flooded.rounds)
    assert flooded.rounds >= 0.9 * quiet.rounds


def test_one_seed_of_a_flood_is_one_history() -> None:
    plan = make_flood_plan(5, rounds=40)
    first, second = run_seed(plan), run_seed(plan)
    assert first.trace == second.trace


def test_what_more_than_f_nodes_do_to_the_others_is_judged_by_nobody() -> None:
    plan = flood_plan("heights")
    more = msgspec.structs.replace(plan.faults[0], node=2)
    history = run_with_history(msgspec.structs.replace(plan, faults=(*plan.faults, more)))[1]
    assert history.of(Flooded) == []


def test_work_takes_time_in_a_quiet_network_too_and_breaks_nothing() -> None:
    plan = Plan(seed=3, rounds=60, cpu=True)
    result, history = run_with_history(plan)
    assert result.violations == ()
    times = [block.at_ms for block in history.of(BlockFinalized)]
    assert times == sorted(times)
