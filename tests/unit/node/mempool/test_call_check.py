"""A call that the version in force cannot take is refused when it is submitted, with what changed."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.errors import BlockRobotError
from node.mempool.call_check import CallCheck
from tests.unit.contracts.system.consortium import Consortium, key_of
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2, activation, agree, disabling, upgrade


class Watched:
    """A chain whose calls are looked at before they are submitted."""

    def __init__(self) -> None:
        self.chain = Consortium()
        self.check = CallCheck(lambda: self.chain.state)

    def refusal(self, contract: str, entry: str, *arguments: Any) -> str:
        transaction = self.chain.sign(key_of("anyone"), contract, entry, *arguments)
        try:
            self.check.require(transaction)
        except BlockRobotError as error:
            return f"{error.code} {error.detail}"
        return ""


@pytest.fixture
def watched() -> Watched:
    watched = Watched()
    upgrade(watched.chain, "visitors", VISITORS)
    return watched


def test_what_the_version_takes_passes_and_the_unknown_is_left_to_the_chain(watched: Watched) -> None:
    assert watched.refusal("visitors", "enter", "Ada") == ""
    assert watched.refusal("nobody-has-it", "enter", "Ada") == ""
    assert watched.refusal("records", "open_visit", bytes(33), bytes(33), 7, 300_000, "care") == ""


def test_a_call_of_an_old_version_is_told_what_changed(watched: Watched) -> None:
    assert watched.refusal("visitors", "enter", "Ada", 3).startswith("CONTRACT_CALL_OUTDATED ARGUMENTS_INVALID")
    upgrade(watched.chain, "visitors", VISITORS_2)
    since = watched.chain.height
    said = f"Version 2 of visitors is active since height {since}:"
    assert watched.refusal("visitors", "enter", "Ada") == (
        f"CONTRACT_CALL_OUTDATED ARGUMENTS_INVALID: {said} enter takes (str, int). Version 1 took (str)."
    )
    assert watched.refusal("visitors", "leave", "Ada") == (
        f"CONTRACT_CALL_OUTDATED ENTRY_UNKNOWN: {said} it has no entry leave. Version 1 had one."
    )
    assert watched.refusal("visitors", "enter", "Ada", 3) == ""


def test_a_disabled_contract_is_said_to_rest_until_it_returns(watched: Watched) -> None:
    agree(watched.chain, "disable", disabling("visitors"))
    watched.chain.block([])
    assert watched.refusal("visitors", "enter", "Ada").startswith("CONTRACT_DISABLED The contract visitors is disabled")
    agree(watched.chain, "activate", activation("visitors", 1))
    watched.chain.block([])
    assert watched.refusal("visitors", "enter", "Ada") == ""


def test_every_entry_of_the_shipped_contracts_is_understood() -> None:
    """Their parameters' types are read from the state, not from the sources."""
    watched = Watched()
    for name, compiled in watched.chain.contracts.items():
        for entry in compiled.abi.entries:
            said = watched.refusal(name, entry.name)
            if entry.kind == "export" and entry.required == 0:
                assert said == ""
            else:
                assert said.startswith("CONTRACT_CALL_OUTDATED"), (name, entry.name)
