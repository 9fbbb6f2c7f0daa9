"""Stories of enrolment: who gets a handle, who does not, and how a membership changes and ends."""

from __future__ import annotations

import pytest

from consensus.members.vouchers import sign_rotation
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import ROOM_MAX_GIB, RobotName, custodian_rooms, read_robot_name
from consensus.visible_text import find_hidden
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, data_of, key_of


def test_a_card_registers_its_bearer_once(hospital: Hospital) -> None:
    anna, card = Person("anna"), hospital.card("anna")
    receipt = hospital.must(anna.identity, "identity", "register", *hospital.register_arguments(anna, card))
    assert data_of(receipt, "registered") == {"member": anna.identity.public_key, "role": "subject"}
    member = hospital.view("identity", "member", anna.identity.public_key)
    assert member["handle"] == card.handle
    assert (member["role"], member["org"], member["status"]) == ("subject", "ward", "active")
    assert (member["spend"], member["sealing"]) == (anna.spend.public_key, anna.sealing)
    assert hospital.view("identity", "member_of_handle", card.handle)["member"] == anna.identity.public_key
    assert "purposes" not in member, "what a member consents to is in the contract consent alone"

    thief = Person("thief")
    again = hospital.send(thief.identity, "identity", "register", *hospital.register_arguments(thief, card))
    assert (again.ok, again.code) == (False, "HANDLE_TAKEN")


def test_a_registration_seen_in_the_mempool_is_of_no_use_to_a_thief(hospital: Hospital) -> None:
    anna, thief = Person("anna"), Person("thief")
    seen = hospital.register_arguments(anna, hospital.card("anna"))
    copied = hospital.send(thief.identity, "identity", "register", *seen)
    assert copied.code == "CARD_SIGNATURE_WRONG"
    own_keys = [*seen[:5], thief.spend.public_key, thief.view.public_key, thief.sealing, *seen[8:]]
    assert hospital.send(thief.identity, "identity", "register", *own_keys).code == "CARD_SIGNATURE_WRONG"
    hospital.must(anna.identity, "identity", "register", *seen)


def test_a_voucher_of_a_stranger_or_another_chain_is_refused(hospital: Hospital) -> None:
    anna = Person("anna")
    card = hospital.card("anna", registrar=key_of("stranger"))
    receipt = hospital.send(anna.identity, "identity", "register", *hospital.register_arguments(anna, card))
    assert receipt.code == "NOT_A_REGISTRAR"
    card = hospital.card("anna", chain_id=bytes(32))
    receipt = hospital.send(anna.identity, "identity", "register", *hospital.register_arguments(anna, card))
    assert receipt.code == "NOT_A_REGISTRAR"


def test_a_subject_cannot_make_herself_a_robot(hospital: Hospital) -> None:
    anna, card = Person("anna"), hospital.card("anna")
    arguments = hospital.register_arguments(anna, card, role="robot")
    assert hospital.send(anna.identity, "identity", "register", *arguments).code == "NOT_A_REGISTRAR"
    arguments = hospital.register_arguments(anna, card, role="admin")
    assert hospital.send(anna.identity, "identity", "register", *arguments).code == "ROLE_UNKNOWN"


def test_an_expired_voucher_is_refused_and_cannot_be_prolonged(hospital: Hospital) -> None:
    anna, card = Person("anna"), hospital.card("anna")
    hospital.time_ms += 2 * DAY_MS
    arguments = hospital.register_arguments(anna, card)
    assert hospital.send(anna.identity, "identity", "register", *arguments).code == "VOUCHER_EXPIRED"
    later = hospital.register_arguments(anna, card, not_after_ms=card.not_after_ms + 5 * DAY_MS)
    assert hospital.send(anna.identity, "identity", "register", *later).code == "NOT_A_REGISTRAR"


def test_one_key_registers_one_handle_and_people_get_no_public_name(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    receipt = hospital.send(
        anna.identity, "identity", "register", *hospital.register_arguments(anna, hospital.card("second"))
    )
    assert receipt.code == "MEMBER_EXISTS"
    receipt = hospital.send(hospital.admin, "identity", "name_robot", anna.handle, "Anna", "")
    assert receipt.code == "ROBOT_UNKNOWN"


@pytest.mark.parametrize("purposes", [["world-domination"], [b"care"], [""], ["care", "care" * 20]])
def test_only_published_purposes_can_be_consented_to(hospital: Hospital, purposes: list[object]) -> None:
    anna = Person("anna")
    arguments = hospital.register_arguments(anna, hospital.card("anna"), purposes=purposes)
    assert hospital.send(anna.identity, "identity", "register", *arguments).code == "PURPOSE_UNKNOWN"


def test_authenticate_shows_that_the_key_is_the_handles(hospital: Hospital) -> None:
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben")
    receipt = hospital.must(anna.identity, "identity", "authenticate", anna.handle)
    assert data_of(receipt, "authenticated") == {"member": anna.identity.public_key}
    assert hospital.send(ben.identity, "identity", "authenticate", anna.handle).code == "NOT_THE_MEMBER"
    assert hospital.send(ben.identity, "identity", "authenticate", bytes(32)).code == "HANDLE_UNKNOWN"


def _rotation(hospital: Hospital, old: Person, new: Person, signer: PrivateKey) -> list[object]:
    signature = sign_rotation(
        new.identity if signer is new.identity else signer,
        chain_id=hospital.chain_id,
        handle=old.handle,
        member=old.identity.public_key,
        spend=new.spend.public_key,
        view=new.view.public_key,
        sealing=new.sealing,
    )
    keys = [new.identity.public_key, new.spend.public_key, new.view.public_key, new.sealing]
    return [old.handle, *keys, signature]


def test_rotation_hands_the_handle_to_the_new_key_and_empties_the_old(hospital: Hospital) -> None:
    anna, new = hospital.enrol("anna"), Person("anna-new")
    hospital.must(anna.identity, "identity", "rotate", *_rotation(hospital, anna, new, new.identity))
    member = hospital.view("identity", "member_of_handle", anna.handle)
    assert (member["member"], member["spend"]) == (new.identity.public_key, new.spend.public_key)
    old = hospital.view("identity", "member", anna.identity.public_key)
    assert (old["status"], old["spend"], old["sealing"]) == ("rotated", b"", b"")
    assert hospital.send(anna.identity, "identity", "authenticate", anna.handle).code == "NOT_THE_MEMBER"
    hospital.must(new.identity, "identity", "authenticate", anna.handle)


def test_a_member_changes_keys_16_times_a_day_and_goes_on_the_next(hospital: Hospital) -> None:
    """Each former key keeps its row."""
    anna = hospital.enrol("anna")
    for number in range(16):
        new = Person(f"anna-{number}", handle=anna.handle)
        hospital.must(anna.identity, "identity", "rotate", *_rotation(hospital, anna, new, new.identity))
        anna = new
    last = Person("anna-last", handle=anna.handle)
    arguments = _rotation(hospital, anna, last, last.identity)
    assert hospital.send(anna.identity, "identity", "rotate", *arguments).code == "WORDS_TOO_MANY"
    hospital.time_ms += DAY_MS
    hospital.must(anna.identity, "identity", "rotate", *arguments)


def test_rotation_needs_the_agreement_of_the_new_key(hospital: Hospital) -> None:
    anna, new, ben = hospital.enrol("anna"), Person("anna-new"), hospital.enrol("ben")
    forged = _rotation(hospital, anna, new, anna.identity)
    assert hospital.send(anna.identity, "identity", "rotate", *forged).code == "ROTATION_SIGNATURE_WRONG"
    onto_ben = _rotation(hospital, anna, ben, ben.identity)
    assert hospital.send(anna.identity, "identity", "rotate", *onto_ben).code == "MEMBER_EXISTS"


def test_leaving_removes_the_keys_and_frees_no_handle(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    hospital.must(anna.identity, "identity", "leave", anna.handle)
    left = hospital.view("identity", "member", anna.identity.public_key)
    assert (left["status"], left["view"]) == ("left", b"")
    assert hospital.view("consent", "choices", anna.handle) == {}
    assert hospital.send(anna.identity, "identity", "authenticate", anna.handle).code == "MEMBER_NOT_ACTIVE"
    ben = Person("ben")
    card = hospital.card("ben", handle=anna.handle)
    receipt = hospital.send(ben.identity, "identity", "register", *hospital.register_arguments(ben, card))
    assert receipt.code == "HANDLE_TAKEN"


@pytest.mark.parametrize("by", ["registrar", "admin"])
def test_a_stolen_robot_is_revoked_and_records_no_more(hospital: Hospital, by: str) -> None:
    anna = hospital.enrol("anna")
    visit = hospital.open_visit(anna)
    hospital.must(key_of(by), "identity", "revoke", hospital.robot.handle)
    record = hospital.send(hospital.robot.identity, "records", "record", *hospital.record_arguments(visit))
    assert record.code == "NOT_A_ROBOT"
    assert hospital.send(key_of(by), "identity", "revoke", hospital.robot.handle).code == "MEMBER_NOT_ACTIVE"


@pytest.mark.parametrize("changed", [0, 1, 4, 5, 6, 7, 8])
def test_a_field_of_a_wrong_size_is_refused(hospital: Hospital, changed: int) -> None:
    anna = Person("anna")
    arguments = hospital.register_arguments(anna, hospital.card("anna"))
    arguments[changed] = arguments[changed][:-1]
    receipt = hospital.send(anna.identity, "identity", "register", *arguments)
    assert receipt.code in {"HANDLE_SIZE_WRONG", "KEY_SIZE_WRONG", "NOT_A_REGISTRAR", "CARD_SIGNATURE_WRONG"}
    assert hospital.view("identity", "member", anna.identity.public_key) is None


def test_genesis_cannot_be_run_a_second_time(hospital: Hospital) -> None:
    crown_me = [[["ward", [key_of("thief").public_key], [key_of("thief").public_key]]], [], []]
    receipt = hospital.send(key_of("thief"), "identity", "genesis", *crown_me)
    assert not receipt.ok
    assert hospital.value("identity", b"registrar/" + key_of("thief").public_key) is None


@pytest.mark.parametrize("by", ["registrar", "admin"])
def test_a_robots_organisation_says_what_it_is_called_and_where_it_is(hospital: Hospital, by: str) -> None:
    robot = hospital.robot.identity.public_key
    receipt = hospital.must(
        key_of(by), "identity", "name_robot", hospital.robot.handle, "Zé (n.º 2)", "Pediatria, 3.º piso"
    )
    assert data_of(receipt, "robot_named")["member"] == robot
    named = read_robot_name(hospital.view("identity", "robot_name", robot))
    assert named == RobotName("Zé (n.º 2)", "Pediatria, 3.º piso")
    hospital.must(key_of(by), "identity", "name_robot", hospital.robot.handle, "Zé", "")
    assert read_robot_name(hospital.view("identity", "robot_name", robot)) == RobotName("Zé", "")


def test_a_robots_name_stays_through_new_keys_and_after_its_end(hospital: Hospital) -> None:
    robot, new = hospital.robot, Person("robot-again")
    hospital.must(hospital.admin, "identity", "name_robot", robot.handle, "Zé", "Ward 4")
    hospital.must(robot.identity, "identity", "rotate", *_rotation(hospital, robot, new, new.identity))
    hospital.must(hospital.admin, "identity", "revoke", robot.handle)
    for key in (robot.identity, new.identity):
        assert read_robot_name(hospital.value("identity", b"robot-name/" + key.public_key)) == RobotName("Zé", "Ward 4")


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("", "Ward 4"),
        ("x" * 33, ""),
        ("Zé", "y" * 49),
        (" Zé", ""),
        ("Zé", "Ward 4 "),
        ("Z\né", ""),
        ("Zé\u202e", ""),
        ("Zé", "\u200bWard"),
        ("Z\x1b[31m", ""),
        ("Z\xad", ""),
        ("\u0405\u0435", ""),
    ],
)
def test_a_name_that_cannot_be_read_is_refused(hospital: Hospital, name: str, place: str) -> None:
    receipt = hospital.send(hospital.admin, "identity", "name_robot", hospital.robot.handle, name, place)
    assert receipt.code == "ROBOT_NAME_WRONG"


def test_a_name_may_have_every_latin_letter_and_no_hidden_character(hospital: Hospital) -> None:
    """The contract's own rule and that of clients agree, character by character."""
    for code in range(0x260):
        word = f"a{chr(code)}b"
        receipt = hospital.send(hospital.admin, "identity", "name_robot", hospital.robot.handle, word, "")
        is_shown = next(find_hidden(word), None) is None and code < 0x250
        assert (receipt.code if not receipt.ok else "") == ("" if is_shown else "ROBOT_NAME_WRONG"), hex(code)


def test_no_two_handles_begin_alike_so_that_a_short_one_names_one_member(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    assert hospital.value("identity", b"short-handle/" + anna.handle[:10]) == anna.handle
    ben = Person("ben")
    card = hospital.card("ben", handle=anna.handle[:10] + bytes(22))
    receipt = hospital.send(ben.identity, "identity", "register", *hospital.register_arguments(ben, card))
    assert receipt.code == "HANDLE_TAKEN"


def test_a_custodian_says_once_a_day_how_much_room_it_has(hospital: Hospital) -> None:
    custodian = hospital.custodians[0]
    assert data_of(hospital.must(custodian, "identity", "declare_room", 4_000), "room_declared") == {
        "custodian": custodian.public_key,
        "gib": 4_000,
    }
    hospital.time_ms += DAY_MS - 1_000
    assert hospital.send(custodian, "identity", "declare_room", 5_000).code == "ROOM_DECLARED_TODAY"
    hospital.time_ms += 1_000
    for wrong in (-1, ROOM_MAX_GIB + 1):
        assert hospital.send(custodian, "identity", "declare_room", wrong).code == "ROOM_WRONG"
    hospital.must(custodian, "identity", "declare_room", ROOM_MAX_GIB)
    assert custodian_rooms(hospital.state)[custodian.public_key] == ROOM_MAX_GIB
