"""A liar about epochs among whole nodes, while epochs change: as a producer, as one that lost its seat, as a newcomer."""

from __future__ import annotations

import pytest

from network.sim.history import BlockFinalized, EpochBegan, History
from network.sim.plan import Governance, Plan
from network.sim.run import run_with_history
from tests.effort import EFFORT

ROUNDS = 60
LIAR = "3"


def play(seed: int, governance: Governance) -> History:
    nodes = 10 if governance == "grow" else 4
    plan = Plan(
        seed=seed, nodes=nodes, producers=4, rounds=ROUNDS, byzantine={LIAR: "wrong-epochs"}, governance=governance
    )
    result, history = run_with_history(plan)
    assert [str(violation) for violation in result.violations] == []
    assert result.acknowledged > 0
    return history


@pytest.mark.parametrize("governance", ["settings", "producers", "grow"])
def test_epochs_change_and_the_chain_goes_on_whatever_is_said_of_other_epochs(governance: Governance) -> None:
    history = play(1, governance)
    assert max(item.epoch for item in history.of(EpochBegan)) >= 1
    assert history.of(BlockFinalized)


@pytest.mark.long
@pytest.mark.parametrize("governance", ["settings", "producers", "grow"])
@pytest.mark.parametrize("seed", range(2, 2 + 2 * EFFORT))
def test_more_seeds_of_it(seed: int, governance: Governance) -> None:
    play(seed, governance)
