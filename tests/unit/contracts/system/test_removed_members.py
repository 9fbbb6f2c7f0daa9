"""Who was registered by an organisation that is no more: its robots and staff lose their roles, its subjects nothing."""

from __future__ import annotations

import pytest

from consensus.members.vouchers import issue_card, sign_card
from consensus.primitives.hashing import sha256
from consensus.state.identity import active_role
from contracts.execution.sender_admission import is_admitted
from node.api.access.principals import resolve_principal
from tests.unit.contracts.system.consortium import (
    DAY_MS,
    Consortium,
    admin_of,
    key_of,
    organisation_fields,
    producer_of,
)


def _register(chain: Consortium, name: str, role: str, organisation: str) -> bytes:
    """Register somebody by a card of the organisation; return the member key."""
    member, spend, view = (key_of(f"{name}/{part}") for part in ("member", "spend", "view"))
    card = issue_card(
        key_of(organisation + "/registrar"),
        chain_id=chain.chain_id,
        handle=sha256(name.encode()),
        card_secret=sha256(name.encode() + b"/card"),
        role=role,
        not_after_ms=chain.time_ms + DAY_MS,
    )
    keys = {
        "member": member.public_key,
        "spend": spend.public_key,
        "view": view.public_key,
        "sealing": sha256(name.encode() + b"/sealing"),
    }
    signature = sign_card(card, chain_id=chain.chain_id, **keys)
    arguments = [card.handle, card.card_public, role, card.not_after_ms, card.voucher_signature]
    arguments += [keys["spend"], keys["view"], keys["sealing"], signature, ["care"]]
    chain.must(member, "identity", "register", *arguments)
    return member.public_key


def test_only_subjects_outlast_their_organisation(consortium: Consortium) -> None:
    roles = ("robot", "staff", "officer", "auditor", "subject")
    members = {role: _register(consortium, role, role, "org-02") for role in roles}
    elsewhere = _register(consortium, "elsewhere", "robot", "org-03")
    consortium.agree("remove_org", {"name": "org-02"})
    found = {role: consortium.view("identity", "role_of", member) for role, member in members.items()}
    assert found == {"robot": "", "staff": "", "officer": "", "auditor": "", "subject": "subject"}
    assert consortium.view("identity", "role_of", elsewhere) == "robot"
    consortium.must(key_of("subject/member"), "identity", "authenticate", sha256(b"subject"))
    again = {**organisation_fields("org-02"), "admins": [key_of("new").public_key]}
    consortium.agree("add_org", again)
    assert consortium.view("identity", "role_of", members["robot"]) == "", "a name that comes back revives nobody"
    newcomer = _register(consortium, "newcomer", "robot", "org-02")
    assert consortium.view("identity", "role_of", newcomer) == "robot"


@pytest.mark.parametrize("role", ["robot", "staff", "officer", "auditor", "subject"])
def test_the_pool_and_the_api_know_the_same_roles_as_the_contracts(consortium: Consortium, role: str) -> None:
    member = _register(consortium, role, role, "org-02")
    transaction = consortium.sign(key_of(f"{role}/member"), "records", "open_visit")

    def agree_on(expected: str) -> None:
        assert consortium.view("identity", "role_of", member) == expected
        assert active_role(consortium.state, member) == expected
        standing = resolve_principal(consortium.state, member)
        assert (set() if standing is None else standing.roles) == ({expected} if expected else set())
        assert is_admitted(consortium.state, transaction, consortium.time_ms) == bool(expected)

    agree_on(role)
    consortium.agree("remove_org", {"name": "org-02"})
    agree_on("subject" if role == "subject" else "")
    consortium.agree("add_org", organisation_fields("org-02"))
    agree_on("subject" if role == "subject" else "")


def test_who_is_on_the_staff_of_a_removed_organisation_can_still_take_consent_back(consortium: Consortium) -> None:
    """Nothing else: he is none of the network's any more, but what robots may record of him is his to say."""
    _register(consortium, "staff", "staff", "org-02")
    key, handle = key_of("staff/member"), sha256(b"staff")
    consortium.agree("remove_org", {"name": "org-02"})
    taking_back = consortium.sign(key, "consent", "withdraw", handle, [], [])
    assert is_admitted(consortium.state, taking_back, consortium.time_ms)
    assert not is_admitted(consortium.state, consortium.sign(key, "access", "request", [], "care"), consortium.time_ms)
    consortium.must(key, "consent", "withdraw", handle, [], [])
    consortium.must(key, "identity", "leave", handle)
    assert not is_admitted(consortium.state, taking_back, consortium.time_ms)


def test_admins_and_registrars_of_a_removed_organisation_stand_no_more(consortium: Consortium) -> None:
    def stands(key_name: str) -> bool:
        transaction = consortium.sign(key_of(key_name), "settings", "propose", "heartbeat_ms", 1)
        return is_admitted(consortium.state, transaction, consortium.time_ms)

    names = ("org-02/admin", "org-02/registrar", "node-02/custodian")
    assert all(stands(name) for name in names)
    consortium.agree("remove_org", {"name": "org-02"})
    assert not any(stands(name) for name in names)
    assert stands("org-01/admin")


@pytest.mark.parametrize(("contract", "entry"), [("producers", "ready"), ("producers", "accuse")])
def test_producers_stand_for_what_producers_say_and_nothing_else(
    consortium: Consortium, contract: str, entry: str
) -> None:
    def stands(name: str, contract: str, entry: str) -> bool:
        transaction = consortium.sign(producer_of(name), contract, entry, 1, bytes(32))
        return is_admitted(consortium.state, transaction, consortium.time_ms)

    assert stands("node-02", contract, entry)
    assert not stands("node-02", contract, "propose")
    assert not stands("node-02", "records", entry)
    assert not stands("node-09", contract, entry)
    consortium.must(admin_of("org-02"), "producers", "remove", producer_of("node-02").public_key)
    assert not stands("node-02", contract, entry)


def test_the_empty_frames_of_a_removed_organisation_are_withdrawn_by_the_others(consortium: Consortium) -> None:
    robot, frame = _register(consortium, "robot", "robot", "org-02"), sha256(b"empty")
    own, other = admin_of("org-02"), admin_of("org-03")
    consortium.must(own, "records", "approve_empty_frames", robot, [frame])
    assert consortium.send(other, "records", "withdraw_empty_frames", robot, [frame]).code == "NOT_OF_THE_ORGANISATION"
    consortium.agree("remove_org", {"name": "org-02"})
    for key in (own, key_of("stranger")):
        assert not consortium.send(key, "records", "withdraw_empty_frames", robot, [frame]).ok
    assert not consortium.send(other, "records", "approve_empty_frames", robot, [sha256(b"more")]).ok
    consortium.must(other, "records", "withdraw_empty_frames", robot, [frame])
    assert consortium.view("records", "empty_frames", robot) == []
