"""The visitor log: who came is in the house until the same desk takes the badge back, and no name is on the chain."""

from __future__ import annotations

import hashlib

import pytest

from contracts.kit import Chain, Contract


def hashed(name: str) -> bytes:
    return hashlib.sha256(b"drawn for this visit" + name.encode()).digest()


ADA, BOB = hashed("Ada"), hashed("Bob")


@pytest.fixture
def log(chain: Chain) -> Contract:
    return chain.deploy("visitor_log.py")


def test_who_signs_in_is_present_until_the_badge_is_back(chain: Chain, log: Contract) -> None:
    assert log.call("sign_in", 7, ADA, "Ward 3", caller="front desk") == 1
    assert log.call("sign_in", 2, BOB, "Ward 3", caller="front desk") == 2
    assert (log.view("present", "Ward 3"), log.view("present", "Ward 4")) == ([2, 7], [])
    chain.advance(minutes=45)
    assert log.call("sign_out", 7, caller="front desk") == 45
    assert log.view("present", "Ward 3") == [2]
    assert log.events("came") == [{"number": 1, "ward": "Ward 3"}, {"number": 2, "ward": "Ward 3"}]
    assert log.events("left") == [{"number": 1, "minutes": 45}]


def test_a_badge_is_with_one_visitor_at_a_time(log: Contract) -> None:
    log.call("sign_in", 7, ADA, "Ward 3", caller="front desk")
    log.expect_failure("BADGE_TAKEN", "sign_in", 7, BOB, "Ward 4", caller="side door")
    log.call("sign_out", 7, caller="front desk")
    log.expect_failure("BADGE_FREE", "sign_out", 7, caller="front desk")
    log.call("sign_in", 7, BOB, "Ward 4", caller="side door")


def test_another_desk_signs_nobody_out(log: Contract) -> None:
    log.call("sign_in", 7, ADA, "Ward 3", caller="front desk")
    failed = log.expect_failure("OTHER_DESK", "sign_out", 7, caller="side door")
    assert failed.message == "The desk that signed somebody in signs them out."
    assert log.view("present", "Ward 3") == [7]


def test_a_desk_can_show_who_came_and_nobody_else_can(chain: Chain, log: Contract) -> None:
    came, desk = chain.time_ms, chain.caller("front desk").key
    log.call("sign_in", 7, ADA, "Ward 3", caller="front desk")
    visit = {"visitor": ADA, "badge": 7, "ward": "Ward 3", "desk": desk, "came": came, "left": 0}
    assert log.view("visit", 1) == visit
    assert log.view("visit", 2) is None
    assert b"Ada" not in repr(log.state).encode()


def test_what_is_entered_has_a_form(log: Contract) -> None:
    for badge in (0, 201):
        log.expect_failure("BADGE_UNKNOWN", "sign_in", badge, ADA, "Ward 3")
    log.expect_failure("VISITOR_WRONG", "sign_in", 1, b"Ada", "Ward 3")
    log.expect_failure("WARD_WRONG", "sign_in", 1, ADA, "x" * 41)


def test_a_full_house_is_found_in_one_view(log: Contract) -> None:
    for badge in range(1, 201):
        log.call("sign_in", badge, ADA, "Ward 3", caller="front desk")
    assert log.view("present", "Ward 3") == list(range(1, 201))
