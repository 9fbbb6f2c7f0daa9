"""The lost-property register: things go to who knows their mark, or in the end to who found them."""

from __future__ import annotations

import hashlib

import pytest

from contracts.kit import Chain, Contract

MARK = "initials A.L. inside the lid"
MARK_HASH = hashlib.sha256(MARK.encode()).digest()


@pytest.fixture
def register(chain: Chain) -> Contract:
    return chain.deploy("lost_property.py")


@pytest.fixture
def watch(chain: Chain, register: Contract) -> int:
    """A watch that Fred found."""
    number: int = register.call("enter", "jewellery", "Corridor 2", MARK_HASH, chain.caller("fred").key, caller="desk")
    return number


def test_who_names_the_mark_gets_the_thing(chain: Chain, register: Contract, watch: int) -> None:
    ada = chain.caller("ada").key
    assert register.call("claim", watch, MARK, caller="ada") is True
    register.call("give_back", watch, ada, caller="desk")
    assert register.events("given_back") == [{"number": watch, "to": ada, "to_finder": False}]
    assert register.view("waiting", "jewellery", 10) == []
    register.expect_failure("GIVEN_BACK", "give_back", watch, ada, caller="desk")
    register.expect_failure("GIVEN_BACK", "claim", watch, MARK, caller="bob")


def test_a_wrong_mark_gets_nothing_and_three_are_enough(chain: Chain, register: Contract, watch: int) -> None:
    for guess in ("gold", "silver", "a dent"):
        assert register.call("claim", watch, guess, caller="bob") is False
    register.expect_failure("TRIED_ENOUGH", "claim", watch, MARK, caller="bob")
    register.expect_failure("NOT_THEIRS", "give_back", watch, chain.caller("bob").key, caller="desk")
    assert register.call("claim", watch, MARK, caller="ada") is True


def test_after_ninety_days_the_finder_gets_it(chain: Chain, register: Contract, watch: int) -> None:
    fred = chain.caller("fred").key
    register.expect_failure("NOT_THEIRS", "give_back", watch, fred, caller="desk")
    chain.advance(days=90)
    register.call("give_back", watch, fred, caller="desk")
    assert register.view("item", watch)["given_to"] == fred


def test_only_the_desk_that_keeps_it_hands_it_out(chain: Chain, register: Contract, watch: int) -> None:
    register.call("claim", watch, MARK, caller="ada")
    register.expect_failure("OTHER_DESK", "give_back", watch, chain.caller("ada").key, caller="other desk")


def test_things_wait_by_kind_in_order(chain: Chain, register: Contract) -> None:
    fred = chain.caller("fred").key
    for kind in ("key", "bag", "key"):
        register.call("enter", kind, "Entrance", MARK_HASH, fred, caller="desk")
    assert register.view("waiting", "key", 10) == [1, 3]
    assert register.view("waiting", "key", 1) == [1]
    assert register.view("waiting", "device", 10) == []


@pytest.mark.parametrize(
    ("code", "kind", "where", "mark_hash"),
    [
        ("KIND_WRONG", "cat", "Entrance", MARK_HASH),
        ("PLACE_WRONG", "bag", "", MARK_HASH),
        ("MARK_WRONG", "bag", "Entrance", b"short"),
    ],
)
def test_what_is_entered_has_a_form(register: Contract, code: str, kind: str, where: str, mark_hash: bytes) -> None:
    register.expect_failure(code, "enter", kind, where, mark_hash, bytes(33), caller="desk")
    register.expect_failure("ITEM_UNKNOWN", "claim", 1, MARK)
