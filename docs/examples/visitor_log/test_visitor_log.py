"""The visitor log: who came is in the house until the same desk signs them out."""

from __future__ import annotations

import pytest

from contracts.kit import Chain, Contract


@pytest.fixture
def log(chain: Chain) -> Contract:
    return chain.deploy("visitor_log.py")


def test_who_signs_in_is_present_until_they_sign_out(chain: Chain, log: Contract) -> None:
    assert log.call("sign_in", "Ada", "Ward 3", caller="front desk") == 1
    assert log.call("sign_in", "Bob", "Ward 4", caller="front desk") == 2
    assert log.view("present") == ["Ada", "Bob"]
    chain.advance(minutes=45)
    assert log.call("sign_out", "Ada", caller="front desk") == 45
    assert log.view("present") == ["Bob"]
    assert log.events("came") == [{"number": 1, "name": "Ada"}, {"number": 2, "name": "Bob"}]
    assert log.events("left") == [{"number": 1, "minutes": 45}]


def test_nobody_is_in_twice_or_leaves_without_having_come(log: Contract) -> None:
    log.call("sign_in", "Ada", "Ward 3", caller="front desk")
    log.expect_failure("ALREADY_IN", "sign_in", "Ada", "Ward 4", caller="side door")
    log.expect_failure("NOT_IN", "sign_out", "Bob", caller="front desk")


def test_another_desk_signs_nobody_out(log: Contract) -> None:
    log.call("sign_in", "Ada", "Ward 3", caller="front desk")
    failed = log.expect_failure("OTHER_DESK", "sign_out", "Ada", caller="side door")
    assert failed.message == "The desk that signed somebody in signs them out."
    assert log.view("present") == ["Ada"]


def test_a_visit_says_who_whom_where_and_when(chain: Chain, log: Contract) -> None:
    came = chain.time_ms
    log.call("sign_in", "Ada", "Ward 3", caller="front desk")
    desk = chain.caller("front desk").key
    assert log.view("visit", 1) == {"name": "Ada", "visits": "Ward 3", "desk": desk, "came": came, "left": 0}
    assert log.view("visit", 2) is None


@pytest.mark.parametrize("name", ["", "x" * 81])
def test_names_have_a_length(log: Contract, name: str) -> None:
    log.expect_failure("NAME_WRONG", "sign_in", name, "Ward 3")
    log.expect_failure("NAME_WRONG", "sign_in", "Ada", name)


def test_the_house_takes_so_many(log: Contract) -> None:
    for number in range(200):
        log.call("sign_in", f"visitor {number}", "Ward 3", caller="front desk")
    log.expect_failure("HOUSE_FULL", "sign_in", "one more", "Ward 3", caller="front desk")
    assert len(log.view("present")) == 200
