"""What a refused call says next: by the contract's own code, from a receipt as from a node's answer."""

from __future__ import annotations

import re

import pytest

from consensus.contract_refusals import NEXT_STEPS, find_next_step
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.rights.purposes import PURPOSES, require_published, require_purpose
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, read_source

OF_THE_MACHINE = {"ARGUMENTS_INVALID", "ENTRY_UNKNOWN"}


def test_a_refusal_says_what_to_do_about_the_rule_and_other_errors_are_not_judged() -> None:
    told = BlockRobotError("CALL_REFUSED", "OFFICER_THE_SAME: Who proposed it cannot approve it.")
    assert told.next_step == NEXT_STEPS["OFFICER_THE_SAME"]
    named = BlockRobotError("CALL_REFUSED", "It was refused.", contract_code="RECORDS_LEFT")
    assert named.next_step == NEXT_STEPS["RECORDS_LEFT"]
    error = BlockRobotError("NOT_FOUND", "RECORDS_LEFT: no.", contract_code="RECORDS_LEFT")
    assert error.next_step == CATALOGUE["NOT_FOUND"].next_step


@pytest.mark.parametrize("detail", ["", "NOT_TODAY: Try tomorrow.", "RISK: none.", "Not so: RECORDS_LEFT."])
def test_where_a_code_says_nothing_more_the_sentence_has_to_do(detail: str) -> None:
    assert find_next_step("", detail) == ""
    assert BlockRobotError("CALL_REFUSED", detail).next_step == CATALOGUE["CALL_REFUSED"].next_step


def test_every_code_is_one_that_a_contract_that_ships_gives() -> None:
    sources = "".join(map(read_source, SHIPPED_CONTRACTS))
    given = set(re.findall(r'"([A-Z][A-Z0-9_]+)"', sources)) | OF_THE_MACHINE
    assert set(NEXT_STEPS) <= given


def test_an_unknown_purpose_is_answered_with_those_that_the_network_publishes() -> None:
    require_published(["care"], ("care", "demo"))
    with pytest.raises(BlockRobotError) as refusal:
        require_published(["care", "spying"], ("care", "demo"))
    assert refusal.value.code == "PURPOSE_UNKNOWN"
    assert refusal.value.detail == "'spying' is no purpose of this network. It publishes: care, demo."
    assert "sentence names" in refusal.value.next_step
    with pytest.raises(BlockRobotError, match="PURPOSE_UNKNOWN") as unknown:
        require_purpose("spying")
    assert all(code in unknown.value.detail for code in PURPOSES)


def test_who_is_registered_already_may_be_a_wallet_or_a_robot() -> None:
    step = NEXT_STEPS["MEMBER_EXISTS"]
    assert "blockrobot wallet records" in step
    assert "blockrobot robot replay" in step
