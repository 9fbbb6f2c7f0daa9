"""Standing: who may have a transaction wait in a node's pool."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.encoding import encode_value
from consensus.state.identity import ADMIN, HANDLE, MEMBER, MemberRow
from consensus.state.keys import to_value
from contracts.execution.sender_admission import find_account, is_admitted
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, key_of


def _stands(hospital: Hospital, name: str, contract: str = "access", entry: str = "request") -> bool:
    transaction = hospital.sign(key_of(name), contract, entry, [], "care")
    return is_admitted(hospital.state, transaction, hospital.time_ms)


def test_members_custodians_registrars_and_admins_stand_until_they_left(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    for name in ("anna/identity", "robot/identity", "custodian-1", "registrar", "admin"):
        assert _stands(hospital, name), name
    assert not _stands(hospital, "stranger")
    hospital.must(anna.identity, "identity", "leave", anna.handle)
    assert not _stands(hospital, "anna/identity")


def test_an_owner_stands_for_access_and_erasure_once_the_visit_is_there(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    visit, arguments = hospital.visit_of(anna)

    def stands(contract: str) -> bool:
        transaction = hospital.sign(visit.key, contract, "request", [], [])
        return is_admitted(hospital.state, transaction, hospital.time_ms)

    assert not stands("access")
    hospital.must(hospital.robot.identity, "records", "open_visit", *arguments)
    assert stands("access")
    assert stands("erasure")
    assert not stands("identity")


def _registration_stands(hospital: Hospital, person: Person, arguments: list[object]) -> bool:
    transaction = hospital.sign(person.identity, "identity", "register", *arguments)
    return is_admitted(hospital.state, transaction, hospital.time_ms)


def test_a_registration_stands_by_its_voucher(hospital: Hospital) -> None:
    anna = Person("anna")
    arguments = hospital.register_arguments(anna, hospital.card("anna"))
    assert _registration_stands(hospital, anna, arguments)
    assert not _registration_stands(hospital, Person("thief"), arguments)
    foreign = hospital.register_arguments(anna, hospital.card("anna", registrar=key_of("stranger")))
    assert not _registration_stands(hospital, anna, foreign)
    hospital.must(anna.identity, "identity", "register", *arguments)
    ben = Person("ben")
    taken = hospital.register_arguments(ben, hospital.card("anna"))
    assert not _registration_stands(hospital, ben, taken)


def test_an_expired_voucher_gives_no_standing(hospital: Hospital) -> None:
    anna = Person("anna")
    arguments = hospital.register_arguments(anna, hospital.card("anna"))
    hospital.time_ms += 2 * DAY_MS
    assert not _registration_stands(hospital, anna, arguments)


@pytest.mark.parametrize("place", range(10))
@pytest.mark.parametrize("value", [None, -1, True, "text", b"", b"x" * 200, [], {}])
def test_no_argument_whatever_breaks_the_check(hospital: Hospital, place: int, value: object) -> None:
    anna = Person("anna")
    arguments = hospital.register_arguments(anna, hospital.card("anna"))
    arguments[place] = value
    transaction = hospital.sign(anna.identity, "identity", "register", *arguments)
    assert is_admitted(hospital.state, transaction, hospital.time_ms) is (place == 9)
    short = hospital.sign(anna.identity, "identity", "register", *arguments[:place])
    assert not is_admitted(hospital.state, short, hospital.time_ms)


class _Rows:
    """A hospital's state with other rows before it."""

    def __init__(self, hospital: Hospital, rows: dict[bytes, Any]) -> None:
        self._hospital = hospital
        self._rows = {key: encode_value(value) for key, value in rows.items()}

    def get(self, key: bytes, /) -> bytes | None:
        return self._rows.get(key) or self._hospital.state.get(key)


def test_no_handle_makes_a_member_pay_from_an_offices_account() -> None:
    """A registrar draws handles, and a name of an organisation can be as long as one."""
    hospital = Hospital()
    organisation = "institute-for-radiology"
    handle = f"admin of {organisation}".encode()
    assert len(handle) == 32
    admin, thief = key_of("radiology/admin").public_key, key_of("thief").public_key
    row = MemberRow(handle, "subject", "ward", thief, thief, bytes(32), "active", 0)
    rows = {ADMIN.key(admin): organisation, HANDLE.key(handle): thief, MEMBER.key(thief): to_value(row)}
    state = _Rows(hospital, rows)
    names = {
        find_account(state, hospital.sign(key_of(who), "consent", "object", bytes(32))).name
        for who in ("radiology/admin", "thief")
    }
    assert names == {f"admin of {organisation}", f"member {handle.hex()}"}
