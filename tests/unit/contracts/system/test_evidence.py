"""Evidence: two signatures of one producer in one round suspend it, and nothing less does."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.chain.genesis import prove_possession
from consensus.primitives.encoding import u32, u64
from consensus.primitives.keys import PrivateKey
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of, producer_of

ACCUSER = producer_of("node-01")
OFFENDER = producer_of("node-02")


def _accuse(chain: Consortium, arguments: list[Any]) -> None:
    chain.must(ACCUSER, "producers", "accuse", *arguments)


@pytest.fixture
def chain() -> Consortium:
    """Three organisations, seven producers."""
    return Consortium(organisations=3, nodes=7)


@pytest.mark.parametrize("kind", ["vote", "proposal"])
def test_two_signatures_in_one_round_cost_the_seat(chain: Consortium, kind: str) -> None:
    arguments = chain.evidence(OFFENDER, kind)
    _accuse(chain, arguments)
    assert "node-02" not in chain.seats
    assert chain.epoch.number == 1
    entry = chain.candidate(OFFENDER.public_key)
    assert (entry["status"], entry["suspended_height"], entry["votes"]) == ("suspended", chain.height, [])
    told = entry["evidence"]
    fields = ["kind", "epoch", "round", "producer", "first_id", "first_signature", "second_id", "second_signature"]
    assert [told[field] for field in fields] == arguments
    assert told["accuser"] == ACCUSER.public_key


def test_forged_evidence_changes_nothing(chain: Consortium) -> None:
    good = chain.evidence(OFFENDER)
    thief = chain.evidence(key_of("thief"))
    before = (chain.chain_id, u32(0), u64(7))
    as_timeout = [OFFENDER.sign_compact("blockrobot/timeout", *before, block_id) for block_id in (good[4], good[6])]
    other_chain = [OFFENDER.sign_compact("blockrobot/vote", bytes(32), u32(0), u64(7), good[place]) for place in (4, 6)]
    forged = [
        ("EVIDENCE_FORGED", {5: thief[5], 7: thief[7]}),
        ("EVIDENCE_FORGED", {7: good[5]}),
        ("EVIDENCE_FORGED", {5: as_timeout[0], 7: as_timeout[1]}),
        ("EVIDENCE_FORGED", {5: other_chain[0], 7: other_chain[1]}),
        ("EVIDENCE_FORGED", {0: "proposal"}),
        ("EVIDENCE_FORGED", {2: 8}),
        ("EVIDENCE_FORGED", {3: producer_of("node-03").public_key}),
        ("EVIDENCE_FORGED", {5: bytes(64)}),
        ("EVIDENCE_FORGED", {5: b""}),
        ("EVIDENCE_WRONG", {6: good[4], 7: good[5]}),
        ("EVIDENCE_WRONG", {4: good[6], 5: good[7], 6: good[4], 7: good[5]}),
        ("EVIDENCE_WRONG", {1: 1}),
        ("EVIDENCE_WRONG", {1: -1}),
        ("EVIDENCE_WRONG", {2: -1}),
        ("EVIDENCE_WRONG", {2: 1 << 60}),
        ("EVIDENCE_WRONG", {4: b""}),
        ("EVIDENCE_KIND_UNKNOWN", {0: "timeout"}),
        ("CANDIDATE_UNKNOWN", {3: key_of("stranger").public_key}),
        ("CANDIDATE_UNKNOWN", {3: b""}),
    ]
    for code, changes in forged:
        arguments = [changes.get(place, value) for place, value in enumerate(good)]
        chain.refused(code, ACCUSER, "producers", "accuse", *arguments)
    _accuse(chain, good)


def test_evidence_counts_once(chain: Consortium) -> None:
    arguments = chain.evidence(OFFENDER)
    _accuse(chain, arguments)
    chain.refused("EVIDENCE_KNOWN", ACCUSER, "producers", "accuse", *arguments)
    more = chain.evidence(OFFENDER, "proposal", 8, epoch=0)
    chain.refused("SUSPENDED_ALREADY", ACCUSER, "producers", "accuse", *more)


def test_two_accusers_in_one_block_make_one_boundary(chain: Consortium) -> None:
    arguments = chain.evidence(OFFENDER)
    accusers = [producer_of("node-03"), ACCUSER]
    receipts = chain.block([chain.sign(key, "producers", "accuse", *arguments) for key in accusers])
    assert [receipt.code for receipt in receipts] == ["OK", "EVIDENCE_KNOWN"]
    assert len(chain.boundaries) == 1


def test_a_majority_reinstates_and_old_evidence_is_over(chain: Consortium) -> None:
    _accuse(chain, chain.evidence(OFFENDER))
    key = OFFENDER.public_key
    chain.must(admin_of("org-01"), "producers", "approve", key)
    chain.ready("node-02")
    assert chain.candidate(key)["status"] == "suspended"
    chain.must(admin_of("org-03"), "producers", "approve", key)
    assert chain.seats[-1] == "node-02"
    assert chain.candidate(key)["evidence"]["round"] == 7, "what was shown stays to be seen"
    old = chain.evidence(OFFENDER, round_number=9, epoch=1)
    chain.refused("EVIDENCE_OLD", ACCUSER, "producers", "accuse", *old)
    _accuse(chain, chain.evidence(OFFENDER, round_number=9))
    assert "node-02" not in chain.seats


def test_of_four_producers_an_offender_keeps_its_seat_and_leads_no_more() -> None:
    chain = Consortium(organisations=3, nodes=4)
    _accuse(chain, chain.evidence(OFFENDER))
    assert (chain.seats, chain.epoch.leaderless) == (["node-01", "node-02", "node-03", "node-04"], (1,))
    assert chain.candidate(OFFENDER.public_key)["status"] == "suspended"
    for name in ("org-01", "org-02"):
        chain.must(admin_of(name), "producers", "approve", OFFENDER.public_key)
    assert (chain.epoch.leaderless, chain.epoch.number) == ((), 2)
    assert chain.candidate(OFFENDER.public_key)["status"] == "producing"


def test_a_newcomer_takes_the_place_of_an_offender_that_was_kept() -> None:
    chain = Consortium(organisations=3, nodes=4)
    _accuse(chain, chain.evidence(OFFENDER))
    chain.grow("node-05")
    assert (chain.seats, chain.epoch.leaderless) == (["node-01", "node-03", "node-04", "node-05"], ())


def test_when_all_are_suspended_all_lead_for_the_chain_must_go_on() -> None:
    chain = Consortium(organisations=1, nodes=2)
    for name, other in (("node-02", "node-01"), ("node-01", "node-02")):
        chain.must(producer_of(other), "producers", "accuse", *chain.evidence(producer_of(name)))
    assert (chain.seats, chain.epoch.leaderless) == (["node-01", "node-02"], ())
    chain.must(admin_of("org-01"), "producers", "approve", OFFENDER.public_key)
    assert (chain.seats, chain.epoch.leaderless) == (["node-01", "node-02"], (0,))
    chain.refused("LAST_PRODUCER", admin_of("org-01"), "producers", "remove", OFFENDER.public_key)


def test_neither_a_new_key_nor_a_removal_washes_an_offender_clean(chain: Consortium) -> None:
    new = key_of("new")
    fields = {
        "node": "node-02",
        "producer_key": new.public_key,
        "producer_possession": prove_possession(new, "node-02"),
    }
    chain.agree("rekey_producer", fields)
    _accuse(chain, chain.evidence(OFFENDER, epoch=0))
    assert chain.candidate(new.public_key)["status"] == "suspended"
    assert "node-02" not in chain.seats
    chain.must(admin_of("org-02"), "producers", "remove", new.public_key)
    chain.must(admin_of("org-02"), "producers", "propose", new.public_key)
    chain.ready("node-02", new)
    assert chain.candidate(new.public_key)["status"] == "suspended"
    assert "node-02" not in chain.seats


def _rekey(chain: Consortium, node: str, key: PrivateKey) -> None:
    proof = prove_possession(key, node)
    chain.agree("rekey_producer", {"node": node, "producer_key": key.public_key, "producer_possession": proof})


def test_a_removed_producer_may_be_accused_and_comes_back_suspended(chain: Consortium) -> None:
    chain.must(admin_of("org-02"), "producers", "remove", OFFENDER.public_key)
    boundaries = len(chain.boundaries)
    _accuse(chain, chain.evidence(OFFENDER, epoch=0))
    entry = chain.candidate(OFFENDER.public_key)
    assert (entry["status"], entry["suspended_height"]) == ("removed", chain.height)
    assert len(chain.boundaries) == boundaries, "who has no seat loses none"
    again = chain.evidence(OFFENDER, round_number=8, epoch=0)
    chain.refused("SUSPENDED_ALREADY", ACCUSER, "producers", "accuse", *again)
    chain.must(admin_of("org-01"), "producers", "propose", OFFENDER.public_key)
    chain.ready("node-02")
    assert chain.candidate(OFFENDER.public_key)["status"] == "suspended"
    assert "node-02" not in chain.seats


@pytest.mark.parametrize("accused_when", ["before the new key", "after it", "with a seat again"])
def test_a_removal_with_a_new_key_after_it_washes_nobody_clean(chain: Consortium, accused_when: str) -> None:
    """Its own organisation removes the liar, a majority that suspects nothing gives it a new key and votes for that."""
    arguments, new = chain.evidence(OFFENDER, epoch=0), key_of("new")
    chain.must(admin_of("org-02"), "producers", "remove", OFFENDER.public_key)
    if accused_when == "before the new key":
        _accuse(chain, arguments)
    _rekey(chain, "node-02", new)
    if accused_when == "after it":
        _accuse(chain, arguments)
    chain.must(admin_of("org-01"), "producers", "propose", new.public_key)
    chain.ready("node-02", new)
    if accused_when == "with a seat again":
        chain.must(admin_of("org-02"), "producers", "approve", new.public_key)
        assert "node-02" in chain.seats
        _accuse(chain, arguments)
    entry = chain.candidate(new.public_key)
    assert (entry["status"], entry["evidence"]["producer"]) == ("suspended", OFFENDER.public_key)
    assert "node-02" not in chain.seats
