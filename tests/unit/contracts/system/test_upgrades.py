"""Contracts that everything stands on are upgraded as any other, and come back if nobody keeps the new version."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from contracts.lifecycle.changed_calls import explain_call
from contracts.lifecycle.changes import GOVERNING
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of
from tests.unit.contracts.system.deploying import (
    VISITORS,
    VISITORS_2,
    activation,
    agree,
    deploy,
    deployment,
    disabling,
    keeping,
    upgrade,
    upload,
)

ANYONE = key_of("anyone")
TRIAL_MS = 24 * 3600 * 1000
CURIOUS = """
@export
def f(data: bytes):
    charge_source(data)


@view
def g() -> dict:
    return {"list": check_source(b"")}
"""


@pytest.fixture
def chain() -> Consortium:
    return Consortium(organisations=3, nodes=3)


def end_trial(chain: Consortium) -> None:
    chain.time_ms += TRIAL_MS
    chain.block([])


def changed(name: str, old: str, new: str) -> str:
    source = read_source(name)
    assert old in source
    return source.replace(old, new)


def test_settings_are_upgraded_on_a_running_chain(chain: Consortium) -> None:
    chain.agree_setting("heartbeat_ms", 2000)
    upgrade(chain, "settings", changed("settings", "[1, 100]", "[1, 50]"))
    chain.refused("VALUE_WRONG", admin_of("org-01"), "settings", "propose", "blocks_per_turn", 51)
    chain.agree_setting("blocks_per_turn", 50)
    assert chain.epoch.settings.blocks_per_turn == 50
    assert chain.epoch.settings.heartbeat_ms == 2000


def test_a_migration_cannot_begin_an_epoch(chain: Consortium) -> None:
    """The block in which it runs may be one that closes an epoch. The machine itself sees to that."""
    upgrade(chain, "lifecycle", changed("lifecycle", '    "settings",\n)', ")"))
    migrating = read_source("settings") + (
        '\n\n@migrate\ndef carry_over():\n    call("producers", "change_setting", "heartbeat_ms", 4000)\n'
    )
    epoch = chain.epoch
    upgrade(chain, "settings", migrating)
    assert chain.epoch == epoch
    record = chain.view("lifecycle", "version", "settings", 2)
    assert (record["status"], record["failure"][:17]) == ("failed", "MIGRATION_REFUSED")
    chain.agree_setting("heartbeat_ms", 2000)


def test_a_proposal_of_before_an_upgrade_is_judged_by_the_new_version(chain: Consortium) -> None:
    proposal_id = chain.must(admin_of("org-01"), "settings", "propose", "blocks_per_turn", 100).txid
    upgrade(chain, "settings", changed("settings", "[1, 100]", "[1, 50]"))
    chain.refused("VALUE_WRONG", admin_of("org-02"), "settings", "approve", proposal_id)


def test_a_privacy_contract_is_upgraded_the_same_way(chain: Consortium) -> None:
    added = read_source("audit") + "\n\n@view\ndef edition() -> int:\n    return 2\n"
    upgrade(chain, "audit", added)
    assert chain.view("audit", "edition") == 2


def test_a_version_of_lifecycle_that_nobody_keeps_goes_by_itself(chain: Consortium) -> None:
    """This one lets nobody propose anything any more: nobody could have undone it."""
    broken = changed("lifecycle", 'require(organisation != "", "NOT_AN_ADMIN"', 'require(False, "NOT_AN_ADMIN"')
    upgrade(chain, "lifecycle", broken)
    chain.refused("NOT_AN_ADMIN", admin_of("org-01"), "lifecycle", "propose", "keep", keeping("lifecycle"))
    end_trial(chain)
    assert chain.view("lifecycle", "contract", "lifecycle")["version"] == 1
    deploy(chain, "visitors", VISITORS)
    chain.must(ANYONE, "visitors", "enter", "Ada")


def test_a_version_of_membership_that_lets_nobody_vote_goes_by_itself(chain: Consortium) -> None:
    broken = changed(
        "membership",
        "settle(proposal_id: bytes, proposal: dict) -> bool:\n",
        'settle(proposal_id: bytes, proposal: dict) -> bool:\n    require(False, "BROKEN", "Broken.")\n',
    )
    upgrade(chain, "membership", broken)
    chain.refused("BROKEN", admin_of("org-01"), "lifecycle", "propose", "keep", keeping("membership"))
    end_trial(chain)
    chain.agree_setting("heartbeat_ms", 2000)
    assert chain.view("lifecycle", "version", "membership", 2)["status"] == "superseded"


def test_a_version_that_governs_stays_if_a_majority_keeps_it(chain: Consortium) -> None:
    upgrade(chain, "lifecycle", changed("lifecycle", "NOTE_MAX_CHARS = 280", "NOTE_MAX_CHARS = 300"))
    assert [entry["kind"] for entry in chain.view("lifecycle", "changes_due")] == ["return"]
    agree(chain, "keep", keeping("lifecycle"))
    end_trial(chain)
    assert chain.view("lifecycle", "contract", "lifecycle")["version"] == 2
    upload(chain, admin_of("org-01"), VISITORS)
    long = deployment("visitors", VISITORS, note="x" * 300)
    chain.must(admin_of("org-01"), "lifecycle", "propose", "deploy", long)
    chain.refused("NO_TRIAL", admin_of("org-01"), "lifecycle", "propose", "keep", keeping("lifecycle"))


def test_keeping_is_about_one_version(chain: Consortium) -> None:
    """Who wants to keep one has not looked at the next."""
    upgrade(chain, "membership", read_source("membership") + "# The second.\n")
    key = admin_of("org-01")
    chain.refused("VERSION_OTHER", key, "lifecycle", "propose", "keep", keeping("membership", 1))
    proposal_id = chain.must(key, "lifecycle", "propose", "keep", keeping("membership", 2)).txid
    upgrade(chain, "membership", read_source("membership") + "# The third.\n")
    chain.refused("PROPOSAL_STALE", admin_of("org-02"), "lifecycle", "approve", proposal_id)
    end_trial(chain)
    assert chain.view("lifecycle", "contract", "membership")["version"] == 1


def test_upgrades_during_a_trial_still_return_to_the_last_version_that_was_kept(chain: Consortium) -> None:
    for number in (300, 400):
        deploy(chain, "lifecycle", changed("lifecycle", "NOTE_MAX_CHARS = 280", f"NOTE_MAX_CHARS = {number}"))
        chain.block([])
    assert chain.view("lifecycle", "contract", "lifecycle")["version"] == 3
    end_trial(chain)
    assert chain.view("lifecycle", "contract", "lifecycle")["version"] == 1
    assert chain.view("lifecycle", "changes_due") == []


def test_who_goes_back_to_the_kept_version_is_not_on_trial(chain: Consortium) -> None:
    upgrade(chain, "forms", changed("forms", "HOST_MAX_CHARS = 253", "HOST_MAX_CHARS = 200"))
    agree(chain, "activate", activation("forms", 1))
    chain.block([])
    assert chain.view("lifecycle", "changes_due") == []
    assert chain.view("lifecycle", "contract", "forms")["version"] == 1


@pytest.mark.parametrize("name", GOVERNING)
def test_a_contract_that_governs_keeps_its_entries_and_cannot_migrate(chain: Consortium, name: str) -> None:
    """What calls it, other contracts and nodes, must find what it knows; and an undone migration could not be undone."""
    key, source = admin_of("org-01"), read_source(name)
    kind = "@export" if "@export" in source else "@view"
    where = source.index(kind + "\ndef ")
    entry = source[where:].split("def ", 1)[1].split("(", 1)[0]
    renamed = source[:where] + source[where:].replace(f"def {entry}(", "def renamed(", 1)
    migrating = source + '\n\n@migrate\ndef carry_over():\n    state.put(b"x", 1)\n'
    for bad, code in ((renamed, "ENTRY_LOST"), (migrating, "MIGRATION_REFUSED")):
        upload(chain, key, bad)
        chain.refused(code, key, "lifecycle", "propose", "deploy", deployment(name, bad))
    chain.refused("GOVERNING", key, "lifecycle", "propose", "disable", disabling(name))


def test_calls_of_an_old_interface_are_told_what_changed(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    height = deploy(chain, "visitors", VISITORS_2)
    said = f"Version 2 of visitors is active since height {height}:"
    old = chain.send(ANYONE, "visitors", "enter", "Bob")
    assert (old.code, old.message) == ("ARGUMENTS_INVALID", f"{said} enter takes (str, int). Version 1 took (str).")
    assert 1000 < old.gas_used < 1200
    gone = chain.send(ANYONE, "visitors", "leave", "Ada")
    assert (gone.code, gone.message) == ("ENTRY_UNKNOWN", f"{said} it has no entry leave. Version 1 had one.")
    view = chain.send(ANYONE, "visitors", "inside")
    assert view.message == f"{said} it has inside as a view, which no transaction calls."
    wrong = chain.send(ANYONE, "visitors", "enter", 5, 5)
    assert wrong.message == f"{said} enter takes (str, int)."
    agree(chain, "activate", activation("visitors", 1))
    newer = chain.send(ANYONE, "visitors", "enter", "Bob", 3)
    assert newer.message.endswith("enter takes (str). Version 2 took (str, int).")
    assert explain_call(chain.state, chain.contracts, "visitors", "enter", ["Bob"]) is None


def test_nobody_else_may_have_sources_compiled(chain: Consortium) -> None:
    source = CURIOUS
    upgrade(chain, "curious", source)
    chain.refused("LIFECYCLE_ONLY", ANYONE, "curious", "f", b"data")
    with pytest.raises(Exception, match="LIFECYCLE_ONLY"):
        chain.view("curious", "g")


def test_views_of_an_old_interface_and_of_a_disabled_contract_are_told_so(chain: Consortium) -> None:
    def refusal(view: str, *arguments: object) -> tuple[str, str]:
        with pytest.raises(BlockRobotError) as caught:
            chain.view("visitors", view, *arguments)
        return caught.value.code, caught.value.detail

    assert refusal("inside") == ("TRANSACTION_CONTRACT_UNKNOWN", "There is no contract of this name.")
    upgrade(chain, "visitors", VISITORS)
    height = chain.height
    since = f"Version 1 of visitors is active since height {height}."
    code, detail = refusal("outside")
    assert (code, detail) == ("TRANSACTION_CONTRACT_UNKNOWN", f"There is no view visitors.outside. {since}")
    code, detail = refusal("inside", 3)
    assert code == "CALL_REFUSED"
    assert "ARGUMENTS_INVALID" in detail
    assert detail.endswith(since)
    agree(chain, "disable", disabling("visitors"))
    chain.block([])
    assert refusal("inside") == (
        "CONTRACT_DISABLED",
        f"The organisations have disabled visitors at height {chain.height}.",
    )
