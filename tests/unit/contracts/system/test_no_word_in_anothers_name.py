"""Who calls a contract lends it nothing: in his name it neither governs nor gives his membership away."""

from __future__ import annotations

from typing import Any

import pytest

from contracts.lifecycle.registry import read_source
from contracts.vm import compile_contract
from tests.unit.contracts.privacy.hospital import Hospital
from tests.unit.contracts.system.callers import ADMINS, RULES, Arguments, Scene
from tests.unit.contracts.system.consortium import Consortium, key_of
from tests.unit.contracts.system.deploying import VISITORS, upgrade

MEDDLER = '''
@export
def enter(contract: str, entry: str, arguments: list):
    """Do something else than the visitor thinks."""
    count = len(arguments)
    if count == 1:
        call(contract, entry, arguments[0])
    elif count == 2:
        call(contract, entry, arguments[0], arguments[1])
    elif count == 4:
        call(contract, entry, arguments[0], arguments[1], arguments[2], arguments[3])
    else:
        call(contract, entry, arguments[0], arguments[1], arguments[2], arguments[3], arguments[4], arguments[5])
'''


@pytest.mark.parametrize(
    ("contract", "entry", "arguments", "allowed"),
    [rule for rule in RULES if rule[3] & ADMINS],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_no_contract_governs_in_an_admins_name(
    contract: str, entry: str, arguments: Arguments, allowed: set[str]
) -> None:
    scene = Scene()
    upgrade(scene.chain, "meddler", MEDDLER)
    values = arguments(scene)
    for name in sorted(allowed & ADMINS):
        root = scene.chain.state.state_root
        receipt = scene.chain.send(scene.everyone[name], "meddler", "enter", contract, entry, values)
        assert receipt.code == "CALL_INDIRECT", name
        assert scene.chain.state.state_root == root


@pytest.mark.parametrize(
    ("entry", "more"),
    [("authenticate", []), ("leave", []), ("rotate", [bytes(33), bytes(33), bytes(33), bytes(32), bytes(65)])],
)
def test_no_contract_gives_a_membership_away(entry: str, more: list[Any]) -> None:
    hospital = Hospital()
    hospital.contracts = {**hospital.contracts, "meddler": compile_contract(MEDDLER, "meddler")}
    anna = hospital.enrol("anna")
    root = hospital.state.state_root
    receipt = hospital.send(anna.identity, "meddler", "enter", "identity", entry, [anna.handle, *more])
    assert receipt.code == "CALL_INDIRECT"
    for key in (hospital.admin, hospital.registrar):
        assert hospital.send(key, "meddler", "enter", "identity", "revoke", [anna.handle]).code == "CALL_INDIRECT"
    assert hospital.state.state_root == root
    hospital.must(anna.identity, "identity", "authenticate", anna.handle)


def test_a_contract_does_call_what_anybody_may(consortium: Consortium) -> None:
    upgrade(consortium, "meddler", MEDDLER)
    upgrade(consortium, "visitors", VISITORS)
    consortium.must(key_of("stranger"), "meddler", "enter", "visitors", "enter", ["Ada"])
    assert consortium.view("visitors", "inside") == ["Ada"]


def test_settings_and_lifecycle_have_a_word_about_their_own_proposals_only() -> None:
    """Membership takes theirs from nobody else, so it must not take one of its own from them."""
    for name in ("settings", "lifecycle"):
        scene = Scene()
        chain = scene.chain
        upgrade(chain, name, read_source(name) + MEDDLER)
        for entry, values in (
            ("propose", ["remove_org", {"name": "org-03"}]),
            ("approve", [scene.proposal]),
            ("withdraw", [scene.proposal]),
        ):
            chain.refused("CALL_INDIRECT", scene.everyone["admin-1"], name, "enter", "membership", entry, values)
            chain.refused("CALL_INDIRECT", scene.everyone["admin-2"], name, "enter", "membership", entry, values)
