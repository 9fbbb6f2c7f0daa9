"""Producers: candidates are voted in, grow from four to ten and shrink back, and the chain always keeps a leader."""

from __future__ import annotations

import pytest

from consensus.chain.schedule import Schedule
from consensus.state.producers import EPOCH
from contracts.execution.epochs import next_epoch, read_epoch
from contracts.execution.executor import execute_block
from tests.unit.contracts.system.consortium import Consortium, admin_of, node_fields, producer_of


def _key(name: str) -> bytes:
    return producer_of(name).public_key


def _names(first: int, last: int) -> list[str]:
    return [f"node-{number:02d}" for number in range(first, last + 1)]


def test_the_first_epoch_is_that_of_the_genesis_file(consortium: Consortium) -> None:
    genesis = consortium.genesis
    assert consortium.epoch.number == 0
    assert consortium.epoch.producers == genesis.schedule.producers
    assert consortium.epoch.settings == genesis.settings
    assert consortium.seats == _names(1, 4)


def test_the_schedule_grows_to_seven_and_ten_and_shrinks_back(consortium: Consortium) -> None:
    consortium.grow(*_names(5, 7))
    assert consortium.seats == _names(1, 7)
    consortium.grow(*_names(8, 10))
    assert consortium.seats == _names(1, 10)
    assert [epoch.number for _, epoch in consortium.boundaries] == [1, 2, 3, 4, 5, 6]
    for name in _names(5, 10):
        consortium.must(admin_of("org-01"), "producers", "remove", _key(name))
    assert consortium.seats == _names(1, 4)
    assert [epoch.number for _, epoch in consortium.boundaries] == list(range(1, 13))
    for _, epoch in consortium.boundaries:
        assert Schedule.of(epoch).producers == epoch.producers


def test_a_candidate_enters_only_with_a_majority_and_its_own_word(consortium: Consortium) -> None:
    consortium.refused("NODE_UNKNOWN", admin_of("org-01"), "producers", "propose", _key("node-05"))
    consortium.agree("add_node", node_fields("node-05", "org-01"))
    consortium.must(admin_of("org-01"), "producers", "propose", _key("node-05"))
    consortium.refused("CANDIDATE_EXISTS", admin_of("org-02"), "producers", "propose", _key("node-05"))
    consortium.refused("APPROVED_ALREADY", admin_of("org-01"), "producers", "approve", _key("node-05"))
    consortium.ready("node-05")
    assert consortium.seats == _names(1, 4)
    consortium.must(admin_of("org-02"), "producers", "approve", _key("node-05"))
    assert consortium.seats == _names(1, 5)
    entry = consortium.candidate(_key("node-05"))
    assert (entry["status"], entry["votes"], entry["ready_height"]) == ("producing", ["org-01", "org-02"], 6)
    height, root = consortium.height, consortium.state.state_root
    consortium.refused("PRODUCING_ALREADY", producer_of("node-05"), "producers", "ready", height, root)


@pytest.mark.parametrize(("blocks", "wait_ms"), [(0, 600_000), (1000, 0)])
def test_a_word_too_long_ago_counts_no_more(consortium: Consortium, blocks: int, wait_ms: int) -> None:
    consortium.agree("add_node", node_fields("node-05", "org-01"))
    consortium.must(admin_of("org-01"), "producers", "propose", _key("node-05"))
    consortium.ready("node-05")
    consortium.time_ms += wait_ms
    consortium.height += blocks
    consortium.must(admin_of("org-02"), "producers", "approve", _key("node-05"))
    assert consortium.seats == _names(1, 4)
    consortium.ready("node-05")
    assert consortium.seats == _names(1, 5)


def test_a_candidate_far_behind_or_ahead_is_not_ready(consortium: Consortium) -> None:
    consortium.agree("add_node", node_fields("node-05", "org-01"))
    consortium.must(admin_of("org-01"), "producers", "propose", _key("node-05"))
    consortium.height = 2000
    for height in (-1, 999, 2001, 5000):
        consortium.refused("HEIGHT_WRONG", producer_of("node-05"), "producers", "ready", height, bytes(32))
        consortium.height = 2000
    consortium.refused("ROOT_WRONG", producer_of("node-05"), "producers", "ready", 2000, b"")


def test_with_fewer_seats_those_with_the_most_votes_stay() -> None:
    chain = Consortium(organisations=3, nodes=5)
    for name in ("node-01", "node-04"):
        chain.must(admin_of("org-02"), "producers", "withdraw", _key(name))
    assert chain.seats == _names(1, 5), "a vote withdrawn costs no seat while there is room"
    chain.agree_setting("max_producers", 4)
    without = {_key("node-01"), _key("node-04")}
    assert set(chain.epoch.producers) == {_key(name) for name in _names(1, 5)} - {max(without)}
    chain.agree_setting("max_producers", 3)
    assert chain.seats == ["node-02", "node-03", "node-05"]


def test_ties_go_to_the_older_candidacy_then_to_the_smaller_key() -> None:
    chain = Consortium(organisations=3, nodes=4)
    for name in _names(5, 7):
        chain.agree("add_node", node_fields(name, "org-01"))
    chain.agree_setting("max_producers", 5)
    for name in ("node-06", "node-05"):
        chain.must(admin_of("org-01"), "producers", "propose", _key(name))
        chain.ready(name)
    chain.block([chain.sign(admin_of("org-02"), "producers", "approve", _key(name)) for name in ("node-05", "node-06")])
    assert chain.seats == ["node-01", "node-02", "node-03", "node-04", "node-06"]
    waiting = chain.candidate(_key("node-05"))
    assert waiting["status"] == "candidate"
    chain.must(admin_of("org-03"), "producers", "approve", _key("node-05"))
    assert chain.seats == ["node-01", "node-02", "node-03", "node-04", "node-06"], (
        "its word was taken at the displacement"
    )


def test_a_candidate_with_more_votes_takes_the_seat_of_one_with_fewer() -> None:
    chain = Consortium(organisations=3, nodes=4)
    chain.agree_setting("max_producers", 4)
    chain.must(admin_of("org-02"), "producers", "withdraw", _key("node-03"))
    chain.agree("add_node", node_fields("node-05", "org-01"))
    chain.vote_in(_key("node-05"))
    chain.ready("node-05")
    assert chain.seats == _names(1, 4), "two votes each: the older stays"
    chain.must(admin_of("org-03"), "producers", "approve", _key("node-05"))
    assert chain.seats == ["node-01", "node-02", "node-04", "node-05"]
    assert chain.candidate(_key("node-03"))["status"] == "candidate"
    chain.must(admin_of("org-02"), "producers", "approve", _key("node-03"))
    assert chain.seats == ["node-01", "node-02", "node-04", "node-05"], "who lost a seat must say anew that it is ready"


def test_a_removal_needs_a_majority_or_the_nodes_own_organisation() -> None:
    chain = Consortium(organisations=4, nodes=6)
    chain.must(admin_of("org-01"), "producers", "remove", _key("node-02"))
    chain.refused("APPROVED_ALREADY", admin_of("org-01"), "producers", "remove", _key("node-02"))
    chain.must(admin_of("org-03"), "producers", "remove", _key("node-02"))
    assert chain.seats == _names(1, 6)
    chain.must(admin_of("org-03"), "producers", "approve", _key("node-02"))
    chain.must(admin_of("org-04"), "producers", "remove", _key("node-02"))
    assert chain.seats == _names(1, 6), "who votes for it again stands for its removal no more"
    chain.must(admin_of("org-03"), "producers", "remove", _key("node-02"))
    assert "node-02" not in chain.seats
    chain.must(admin_of("org-03"), "producers", "remove", _key("node-03"))
    assert chain.seats == ["node-01", "node-04", "node-05", "node-06"]
    chain.refused("CANDIDATE_UNKNOWN", admin_of("org-02"), "producers", "approve", _key("node-02"))


def test_a_removed_producer_may_be_proposed_again(consortium: Consortium) -> None:
    consortium.must(admin_of("org-02"), "producers", "remove", _key("node-02"))
    assert consortium.seats == ["node-01", "node-03", "node-04"]
    consortium.vote_in(_key("node-02"))
    consortium.ready("node-02")
    assert consortium.seats == ["node-01", "node-03", "node-04", "node-02"]


def test_no_removal_leaves_the_chain_without_a_producer() -> None:
    chain = Consortium(organisations=1, nodes=1)
    chain.refused("LAST_PRODUCER", admin_of("org-01"), "producers", "remove", _key("node-01"))
    chain.refused("LAST_PRODUCER", admin_of("org-01"), "producers", "withdraw", _key("node-01"))
    assert chain.seats == ["node-01"]


def test_a_second_change_in_one_block_takes_the_place_of_the_first() -> None:
    chain = Consortium(organisations=1, nodes=6)
    admin = admin_of("org-01")
    chain.block([chain.sign(admin, "producers", "remove", _key(name)) for name in ("node-05", "node-06")])
    assert chain.boundaries == [(1, chain.epoch)]
    assert (chain.epoch.number, chain.seats) == (1, _names(1, 4))
    chain.block([])
    chain.must(admin, "producers", "remove", _key("node-04"))
    assert [(height, epoch.number) for height, epoch in chain.boundaries] == [(1, 1), (3, 2)]


def test_a_block_is_a_boundary_only_by_what_it_writes() -> None:
    chain = Consortium()
    transaction = chain.sign(admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-04"})
    result = execute_block(chain.state, chain.contracts, chain.context(), [transaction])
    assert result.receipts[0].ok
    assert next_epoch(result.writes, 0) is None
    written = {EPOCH.flat: chain.state.get(EPOCH.flat)}
    assert next_epoch(written, 0) is None
    assert next_epoch(written, 7) == read_epoch(chain.state)


def test_candidates_are_bounded() -> None:
    chain = Consortium(organisations=2, nodes=21)
    admin = admin_of("org-01")
    for number in range(22, 43):
        chain.agree("add_node", node_fields(f"node-{number}", f"org-0{number % 2 + 1}"))
        chain.must(admin, "producers", "propose", _key(f"node-{number}"))
    chain.agree("add_node", node_fields("node-43", "org-01"))
    chain.refused("CANDIDATES_TOO_MANY", admin, "producers", "propose", _key("node-43"))
    assert len(chain.view("producers", "candidates")) == 42
