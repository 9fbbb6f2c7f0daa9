"""Governance lets a network grow from four producers to seven and ten, and shrink back: whole nodes, under load."""

from __future__ import annotations

import itertools

import msgspec
import pytest

from consensus.chain.genesis import ChainSettings
from network.sim.history import BlockFinalized, Ended, EpochBegan, Healed, History, VoteSent
from network.sim.plan import make_growth_plan
from network.sim.run import run_with_history
from network.sim.sweep import sweep
from tests.effort import EFFORT

SEEDS_COUNT = 4 * EFFORT


def play(seed: int, *, rounds: int, is_calm: bool = False) -> History:
    """Play the growth of a seed; nothing that is promised may break."""
    plan = make_growth_plan(seed, rounds=rounds)
    result, history = run_with_history(msgspec.structs.replace(plan, faults=()) if is_calm else plan)
    assert [str(violation) for violation in result.violations] == []
    assert result.acknowledged > 0
    return history


def seats_of(history: History) -> list[int]:
    """Return how many producers the epochs had, in their order."""
    return [len(producers) for _, producers in sorted({item.epoch: item.producers for item in begun(history)}.items())]


def begun(history: History) -> list[EpochBegan]:
    return history.of(EpochBegan)


@pytest.fixture(scope="module")
def calm() -> History:
    """A network that grows and shrinks without faults."""
    return play(1, rounds=120, is_calm=True)


def test_governance_seats_six_followers_in_two_steps_and_unseats_them_again(calm: History) -> None:
    seats = seats_of(calm)
    assert seats[0] == 4
    top = seats.index(10)
    assert 7 in seats[:top]
    assert seats[:top] == sorted(seats[:top])
    assert 4 in seats[top:]


def test_finality_has_no_gap_longer_than_two_timed_out_rounds_while_the_network_grows(calm: History) -> None:
    over_ms = calm.of(Healed)[0].at_ms  # clients go home soon after, and an idle network makes no blocks
    blocks = [block for block in calm.of(BlockFinalized) if block.at_ms < over_ms]
    times = sorted({block.height: block.at_ms for block in reversed(blocks)}.values())
    gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert max(gaps) <= 2 * ChainSettings().base_timeout_ms


def test_a_node_votes_in_epochs_that_seat_it_and_in_no_other(calm: History) -> None:
    seats = {item.epoch: len(item.producers) for item in begun(calm)}
    voters: dict[int, set[int]] = {}
    for vote in calm.of(VoteSent):
        voters.setdefault(vote.epoch, set()).add(vote.node)
    assert any(voters.get(epoch) == set(range(10)) for epoch, count in seats.items() if count == 10)
    assert all(voters.get(epoch, set()) <= {0, 1, 2, 3} for epoch, count in seats.items() if count == 4)
    assert all(len(voters.get(epoch, ())) <= count for epoch, count in seats.items())


def test_all_ten_end_with_the_same_blocks(calm: History) -> None:
    heights = calm.of(Ended)[-1].heights
    assert len(heights) == 10
    assert len(set(heights)) == 1


@pytest.mark.parametrize("seed", [2, 3])
def test_a_network_grows_under_the_faults_of_a_seed(seed: int) -> None:
    assert max(seats_of(play(seed, rounds=80))) >= 7


@pytest.mark.long
@pytest.mark.timeout(1_800)
def test_many_seeds_of_growth_keep_every_promise() -> None:
    total = sweep([make_growth_plan(seed) for seed in range(100, 100 + SEEDS_COUNT)])
    assert [str(violation) for result in total.failed for violation in result.violations] == []
    assert total.seeds == SEEDS_COUNT
