"""The lost-property register: things go to who knew their mark beforehand, or in the end to who found them."""

from __future__ import annotations

import hashlib

import pytest

from contracts.kit import Chain, Contract

MARK = "initials A.L. inside the lid"
SALT, BLIND = bytes(range(16)), bytes(range(16, 32))
SEAL = hashlib.sha256(SALT + MARK.encode()).digest()


def answer_of(chain: Chain, who: str, mark: str = MARK) -> bytes:
    return hashlib.sha256(BLIND + chain.caller(who).key + mark.encode()).digest()


@pytest.fixture
def register(chain: Chain) -> Contract:
    return chain.deploy("lost_property.py")


@pytest.fixture
def watch(chain: Chain, register: Contract) -> int:
    """A watch that Fred found."""
    number: int = register.call("enter", "jewellery", "Corridor 2", SEAL, chain.caller("fred").key, caller="desk")
    return number


def test_who_knows_the_mark_gets_the_thing(chain: Chain, register: Contract, watch: int) -> None:
    ada = chain.caller("ada").key
    register.call("claim", watch, answer_of(chain, "ada"), caller="ada")
    register.call("give_back", watch, ada, MARK, SALT, BLIND, caller="desk")
    assert register.events("given_back") == [{"number": watch, "to": ada}]
    assert register.view("item", watch)["given_to"] == ada
    assert register.view("waiting", "jewellery", 10) == []
    register.expect_failure("GIVEN_BACK", "claim", watch, answer_of(chain, "bob"), caller="bob")


def test_a_guess_gets_nothing_and_there_is_only_one(chain: Chain, register: Contract, watch: int) -> None:
    bob = chain.caller("bob").key
    register.call("claim", watch, answer_of(chain, "bob", "gold"), caller="bob")
    register.expect_failure("CLAIMED_ALREADY", "claim", watch, answer_of(chain, "bob"), caller="bob")
    register.expect_failure("NOT_THEIRS", "give_back", watch, bob, MARK, SALT, BLIND, caller="desk")
    register.expect_failure("MARK_WRONG", "give_back", watch, bob, "gold", SALT, BLIND, caller="desk")


def test_a_copied_claim_is_worth_nothing(chain: Chain, register: Contract, watch: int) -> None:
    register.call("claim", watch, answer_of(chain, "ada"), caller="bob")
    bob = chain.caller("bob").key
    register.expect_failure("NOT_THEIRS", "give_back", watch, bob, MARK, SALT, BLIND, caller="desk")


def test_who_claimed_nothing_gets_nothing(chain: Chain, register: Contract, watch: int) -> None:
    ada = chain.caller("ada").key
    register.expect_failure("NOT_THEIRS", "give_back", watch, ada, MARK, SALT, BLIND, caller="desk")
    register.expect_failure("OPENING_WRONG", "give_back", watch, ada, MARK, b"", BLIND, caller="desk")


def test_after_ninety_days_the_finder_gets_it(chain: Chain, register: Contract, watch: int) -> None:
    register.expect_failure("TOO_EARLY", "give_to_finder", watch, caller="desk")
    chain.advance(days=90)
    register.call("give_to_finder", watch, caller="desk")
    assert register.view("item", watch)["given_to"] == chain.caller("fred").key


def test_only_the_desk_that_keeps_it_hands_it_out(chain: Chain, register: Contract, watch: int) -> None:
    register.call("claim", watch, answer_of(chain, "ada"), caller="ada")
    ada = chain.caller("ada").key
    register.expect_failure("OTHER_DESK", "give_back", watch, ada, MARK, SALT, BLIND, caller="ada")
    chain.advance(days=90)
    register.expect_failure("OTHER_DESK", "give_to_finder", watch, caller="fred")


def test_things_wait_by_kind_in_order(chain: Chain, register: Contract) -> None:
    fred = chain.caller("fred").key
    for kind in ("key", "bag", "key"):
        register.call("enter", kind, "Entrance", SEAL, fred, caller="desk")
    assert register.view("waiting", "key", 10) == [1, 3]
    assert register.view("waiting", "key", 1) == [1]
    assert register.view("waiting", "device", 10) == []


@pytest.mark.parametrize(
    ("code", "kind", "where", "seal"),
    [
        ("KIND_WRONG", "cat", "Entrance", SEAL),
        ("PLACE_WRONG", "bag", "", SEAL),
        ("SEAL_WRONG", "bag", "Entrance", b"short"),
    ],
)
def test_what_is_entered_has_a_form(register: Contract, code: str, kind: str, where: str, seal: bytes) -> None:
    register.expect_failure(code, "enter", kind, where, seal, bytes(33), caller="desk")
    register.expect_failure("ITEM_UNKNOWN", "claim", 1, bytes(32))


def test_an_answer_has_a_form(register: Contract, watch: int) -> None:
    register.expect_failure("ANSWER_WRONG", "claim", watch, b"short", caller="ada")
    register.expect_failure("ITEM_UNKNOWN", "claim", 0, bytes(32), caller="ada")
