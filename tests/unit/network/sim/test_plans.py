"""Plans: drawn from a seed, written and read back, and cut down to what breaks something."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.measure.sim_commands import run_command
from network.sim.checkers import Violation
from network.sim.plan import Fault, Plan, make_custody_plan, make_flood_plan, make_growth_plan, make_plan
from network.sim.plan_file import find_problem, load_plan, plan_to_toml
from network.sim.run import RunResult
from network.sim.shrink import shrink_plan


@pytest.mark.parametrize("seed", range(40))
def test_a_printed_plan_is_read_back_as_it_was(seed: int, tmp_path: Path) -> None:
    plan = make_plan(seed, nodes=7, byzantine=seed % 3, behaviours=("equivocate", "garbage"))
    (tmp_path / "plan.toml").write_text(plan_to_toml(plan))
    assert load_plan(tmp_path / "plan.toml") == plan


def test_plans_of_growth_of_custody_and_of_floods_are_read_back_as_they_were(tmp_path: Path) -> None:
    for make, size in ((make_growth_plan, (10, 4, False)), (make_custody_plan, (7, 4, True))):
        plan = make(3, rounds=40)
        (tmp_path / "plan.toml").write_text(plan_to_toml(plan))
        assert load_plan(tmp_path / "plan.toml") == plan
        assert plan.size == size
        assert not any(fault.kind == "old-disk" for seed in range(60) for fault in make(seed).faults)
    assert (
        find_problem(Plan(seed=1, nodes=6, governance="custody"))
        == "custodians come and go among 7 nodes, 4 of them producers"
    )
    for seed in range(20):
        plan = make_flood_plan(seed, nodes=7)
        assert len({fault.node for fault in plan.faults}) == 2
        (tmp_path / "plan.toml").write_text(plan_to_toml(plan))
        assert load_plan(tmp_path / "plan.toml") == plan


def test_a_seed_draws_one_plan_and_one_in_eight_lets_every_node_execute_for_itself() -> None:
    assert make_plan(5) == make_plan(5)
    assert make_plan(5) != make_plan(6)
    apart = [seed for seed in range(1, 33) if make_plan(seed).executes_apart]
    assert apart == [8, 16, 24, 32]
    assert "executes_apart = true" in plan_to_toml(make_plan(8))


def test_a_plan_that_is_misspelt_no_text_or_said_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text('seed = 1\n[[faults]]\nkind = "crush"\nat_ms = 1\nfor_ms = 2\n')
    with pytest.raises(BlockRobotError, match="crush"):
        load_plan(path)
    with pytest.raises(BlockRobotError, match=r"plan\.toml"):
        load_plan(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(BlockRobotError, match=r"plan\.toml"):
        load_plan(path)
    path.write_text("seed = 1\nrounds = 10\n")
    result = CliRunner().invoke(run_command, ["--plan", str(path), "--seeds", "3"])
    assert result.exit_code == 2
    assert "--seeds" in result.output


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("seed = -7", "seed"),
        ("seed = 1\nrounds = 99999999999", "rounds"),
        ('seed = 1\nprofile = "wofi"', "wifi"),
        ("seed = 1\nproducers = 5", "producers"),
        ('seed = 1\n[byzantine]\n4 = "equivocate"', "no node 4"),
        ('seed = 1\n[byzantine]\nx = "equivocate"', "no node x"),
        ('seed = 1\n[byzantine]\n1 = "lie"', "equivocate"),
        ('seed = 1\n[[faults]]\nkind = "crash"\nat_ms = 1\nfor_ms = 2\nnode = 22', "0 to 3"),
        ('seed = 1\n[[faults]]\nkind = "crash"\nat_ms = -400\nfor_ms = 2\nnode = 2', "begins"),
        ('seed = 1\n[[faults]]\nkind = "crash"\nat_ms = 4\nfor_ms = 2\nnode = 2\npoint = "foo"', "before-sync"),
        ('seed = 1\n[[faults]]\nkind = "old-disk"\nat_ms = 4\nfor_ms = 2\nnode = 2', "machine"),
        ('seed = 1\n[[faults]]\nkind = "links"\nat_ms = 4\nfor_ms = 2\nprofile = ""', "storm"),
        ('seed = 1\n[[faults]]\nkind = "one-way"\nat_ms = 4\nfor_ms = 2\nnode = 2\npeer = 2', "another"),
        ('seed = 1\n[[faults]]\nkind = "partition"\nat_ms = 4\nfor_ms = 2\ngroups = [[0, 1]]', "groups"),
        ('seed = 1\n[[faults]]\nkind = "partition"\nat_ms = 4\nfor_ms = 2\ngroups = [[0, 1], [1, 2]]', "in two"),
        ('seed = 1\n[[faults]]\nkind = "slow-disk"\nat_ms = 4\nfor_ms = 2\nnode = 2\namount = -3', "amount"),
        ('seed = 1\n[[faults]]\nkind = "flood"\nat_ms = 4\nfor_ms = 2\nnode = 2\npoint = "ranges"\namount = 9', "cpu"),
        (
            'seed = 1\ncpu = true\n[[faults]]\nkind = "flood"\nat_ms = 4\nfor_ms = 2\nnode = 2\npoint = "foo"\namount = 9',
            "ranges",
        ),
        (
            'seed = 1\ncpu = true\n[[faults]]\nkind = "flood"\nat_ms = 4\nfor_ms = 2\nnode = 2\npoint = "ranges"',
            "KiB a second",
        ),
    ],
)
def test_a_plan_that_could_not_be_played_as_it_reads_is_refused(text: str, named: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(BlockRobotError, match=named) as refused:
        load_plan(path)
    assert refused.value.code == "CONFIGURATION_INVALID"


def test_every_plan_that_is_drawn_can_be_played_and_makes_no_more_faulty_than_the_network_bears() -> None:
    drawn = [make_plan(seed, nodes=nodes, byzantine=(nodes - 1) // 3) for seed in range(60) for nodes in (1, 4, 10)]
    grown = [make_growth_plan(seed) for seed in range(60)]
    floods = [make_flood_plan(seed, nodes=nodes) for seed in range(60) for nodes in (4, 10)]
    assert {find_problem(plan) for plan in [*drawn, *grown, *floods]} == {""}
    plans = [make_plan(seed, byzantine=1, behaviours=("garbage",)) for seed in range(200)]
    assert not any(
        fault.kind == "old-disk" or plan.governance == "producers" for plan in plans for fault in plan.faults
    )


def result_of(plan: Plan, *checkers: str) -> RunResult:
    violations = tuple(Violation(checker, 0.0, -1, "broken") for checker in checkers)
    return RunResult(plan.seed, "", violations, 0, 0, 0, 0, 0.0, 0.0)


def test_shrinking_leaves_only_the_two_faults_that_break_something_together() -> None:
    def crash(node: int) -> Fault:
        return Fault(kind="crash", at_ms=10 * node, for_ms=64, node=node)

    def play(plan: Plan) -> RunResult:
        nodes = {fault.node for fault in plan.faults}
        return result_of(plan, *(["agreement"] if {3, 8} <= nodes else []))

    plan = Plan(seed=1, rounds=80, byzantine={"2": "garbage"}, faults=tuple(crash(node) for node in range(12)))
    shrunk, found = shrink_plan(plan, play(plan), play)
    assert [fault.node for fault in shrunk.faults] == [3, 8]
    assert shrunk.byzantine == {}
    assert shrunk.rounds < 80
    assert {violation.checker for violation in found.violations} == {"agreement"}


def test_shrinking_does_not_take_another_break_for_the_one_that_it_was_given() -> None:
    def play(plan: Plan) -> RunResult:
        return result_of(plan, "agreement" if len(plan.faults) > 1 else "liveness")

    plan = Plan(seed=1, faults=tuple(Fault(kind="power-cut", at_ms=n, for_ms=1) for n in range(4)))
    shrunk, _ = shrink_plan(plan, play(plan), play)
    assert len(shrunk.faults) == 2


def test_a_plan_that_went_through_pickle_reads_and_prints_as_it_did() -> None:
    """Workers are given their plans that way, and what a fault prints as is a part of the history."""
    for seed in range(60):
        plan = make_plan(seed)
        sent = pickle.loads(pickle.dumps(plan))
        assert [str(fault) for fault in sent.faults] == [str(fault) for fault in plan.faults]
        assert plan_to_toml(sent) == plan_to_toml(plan)


def test_a_fault_says_only_what_is_not_as_usual() -> None:
    assert str(Fault(kind="crash", at_ms=1, for_ms=2, node=3)) == "1 ms: crash for 2 ms (node 3)"
    assert str(Fault(kind="crash", at_ms=1, for_ms=2, point="".join(["no", "w"]))) == "1 ms: crash for 2 ms"
