"""Stories of transfer: the wallet was stolen, and what was recorded of its owner goes to a key that the thief has not."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.keys import PrivateKey
from consensus.records.owner_keys import scan_announcement, sign_transfer
from consensus.state.records import decided_root
from contracts.execution.sender_admission import is_admitted
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit, data_of, key_of

NEW_ANNA = Person("anna with new words")
RESTRICTED = ([], "accuracy")


def words_of(visit: Visit) -> list[tuple[str, str, list[Any]]]:
    """Everything that the key of a visit can say of it."""
    record_id = visit.records[0]
    return [
        ("access", "request", [[record_id], "own-access"]),
        ("access", "request", [[], "own-access"]),
        ("access", "verdict", [[[record_id, "verified", []]]]),
        ("rights", "restrict", [[record_id], "accuracy"]),
        ("rights", "lift", [[record_id]]),
        ("rights", "object_to_release", [["care"]]),
        ("rights", "rectify", [[record_id], "attribution", bytes(32)]),
        ("erasure", "request", [[record_id], [0]]),
        ("erasure", "request", [[visit.records[1]], []]),
        ("rights", "wrong_person", []),
    ]


def test_the_new_key_is_announced_as_a_visit_is_and_leads_to_the_first_key(hospital: Hospital, visit: Visit) -> None:
    new, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)
    receipt = hospital.must(visit.key, "records", "transfer", *arguments)
    assert data_of(receipt, "transferred") == {
        "owner": visit.owner,
        "new_owner": new.public_key,
        "ephemeral": arguments[1],
        "view_tag": arguments[2],
        "sequence": 1,
    }
    opened, announced = hospital.view("records", "announcements", 0, 10)
    robot = hospital.robot.identity.public_key
    assert announced == [new.public_key, *arguments[1:3], visit.bucket_ms, robot, visit.owner]
    assert len(opened) == 5
    found = scan_announcement(
        NEW_ANNA.view, NEW_ANNA.spend.public_key, announced[1], announced[2], chain_id=hospital.chain_id, robot=robot
    )
    assert found == new.public_key
    assert hospital.view("records", "root_of", new.public_key) == visit.owner
    assert hospital.view("records", "current_of", visit.owner) == new.public_key


def test_the_new_key_decides_of_all_there_was_and_is_still_to_come(hospital: Hospital, visit: Visit) -> None:
    new = hospital.transfer(visit, NEW_ANNA)
    hospital.record(visit)
    for contract, entry, arguments in words_of(visit):
        hospital.must(new, contract, entry, *arguments)
    kinds = [event["kind"] for event in hospital.view("audit", "events", visit.owner, 0, 100)]
    assert kinds[:6] == ["visit_opened", "recorded", "recorded", "recorded", "transferred", "recorded"]
    assert kinds[-1] == "denied"
    assert hospital.view("audit", "events", new.public_key, 0, 100) == []


def test_whoever_stole_the_old_words_decides_nothing_any_more(hospital: Hospital, visit: Visit) -> None:
    hospital.transfer(visit, NEW_ANNA)
    trail = hospital.value("audit", b"count/" + visit.owner)
    _, to_the_thief = hospital.transfer_arguments(visit.owner, Person("thief"), 7)
    for contract, entry, arguments in [*words_of(visit), ("records", "transfer", to_the_thief)]:
        assert hospital.send(visit.key, contract, entry, *arguments).code == "VISIT_TRANSFERRED", (contract, entry)
        waiting = hospital.sign(visit.key, contract, entry, *arguments)
        assert not is_admitted(hospital.state, waiting, hospital.time_ms)
    assert hospital.value("audit", b"count/" + visit.owner) == trail


def test_a_key_waits_with_a_transfer_only_while_it_decides(hospital: Hospital, visit: Visit) -> None:
    new, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)

    def stands(key: PrivateKey, contract: str = "records", entry: str = "transfer") -> bool:
        return is_admitted(hospital.state, hospital.sign(key, contract, entry, *arguments), hospital.time_ms)

    assert stands(visit.key)
    assert not stands(visit.key, "records", "record")
    assert not stands(new)
    hospital.must(visit.key, "records", "transfer", *arguments)
    assert (stands(visit.key), stands(new), stands(new, "access", "request")) == (False, True, True)
    assert decided_root(hospital.state, new.public_key) == visit.owner
    assert decided_root(hospital.state, visit.owner) is None
    assert decided_root(hospital.state, key_of("stranger").public_key) is None


def test_what_was_asked_and_restricted_before_stays_with_the_visit(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    hospital.must(visit.key, "rights", "restrict", *RESTRICTED)
    erasing = hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    new = hospital.transfer(visit, NEW_ANNA)
    assert hospital.view("access", "get", asked.txid)["owner"] == visit.owner
    assert hospital.send(new, "access", "request", [], "care").code == "RECORD_RESTRICTED"
    hospital.must(new, "rights", "lift", [])
    hospital.receipts_of_all(erasing.txid)
    assert hospital.view("records", "get", visit.records[0])["status"] == "erased"


def test_a_denied_visit_can_be_transferred_and_stays_denied(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "wrong_person")
    new = hospital.transfer(visit, NEW_ANNA)
    assert hospital.send(new, "access", "request", [], "own-access").code == "VISIT_QUARANTINED"
    assert hospital.send(visit.key, "access", "request", [], "own-access").code == "VISIT_TRANSFERRED"


def test_the_robot_goes_on_under_the_first_key_and_knows_no_other(hospital: Hospital, visit: Visit) -> None:
    new = hospital.transfer(visit, NEW_ANNA)
    robot = hospital.robot.identity
    arguments = hospital.record_arguments(visit, 9, owner=new.public_key)
    assert hospital.send(robot, "records", "record", *arguments).code == "VISIT_UNKNOWN"
    assert hospital.send(robot, "records", "close_visit", new.public_key, 3).code == "VISIT_UNKNOWN"
    hospital.must(robot, "records", "close_visit", visit.owner, 3)
    assert hospital.view("records", "visit", visit.owner)["status"] == "closed"
    assert hospital.view("records", "visit", new.public_key) is None
    hospital.must(new, "access", "request", [], "own-access")


def test_no_key_is_ever_used_twice(hospital: Hospital, visit: Visit) -> None:
    other = hospital.open_visit(hospital.enrol("ben"))
    new, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)
    hospital.must(visit.key, "records", "transfer", *arguments)
    for key, root in ((new, visit.owner), (other.key, other.owner)):
        for used in (visit.key, new):
            agreed = sign_transfer(used, chain_id=hospital.chain_id, root=root)
            said = [used.public_key, *arguments[1:3], agreed]
            assert hospital.send(key, "records", "transfer", *said).code == "VISIT_EXISTS"
    reopening = [*arguments[:3], hospital.bucket(), "care"]
    assert hospital.send(hospital.robot.identity, "records", "open_visit", *reopening).code == "VISIT_EXISTS"


@pytest.mark.parametrize(
    ("place", "value", "code"),
    [(0, b"x", "KEY_SIZE_WRONG"), (1, b"x", "KEY_SIZE_WRONG"), (2, 256, "VIEW_TAG_WRONG"), (2, -1, "VIEW_TAG_WRONG")],
)
def test_what_is_no_key_is_refused(hospital: Hospital, visit: Visit, place: int, value: Any, code: str) -> None:
    _, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)
    arguments[place] = value
    assert hospital.send(visit.key, "records", "transfer", *arguments).code == code
    assert hospital.view("records", "current_of", visit.owner) == visit.owner


def test_nobody_takes_up_a_key_that_he_does_not_hold(hospital: Hospital, visit: Visit) -> None:
    """Neither of somebody with whom a record was shared, nor one that a robot is about to use, nor no point at all."""
    new, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)
    elsewhere = hospital.open_visit(hospital.enrol("ben"))
    hers, chain_id = key_of("hers"), hospital.chain_id
    forged = [
        [hers.public_key, *arguments[1:]],
        [bytes(33), *arguments[1:]],
        [*arguments[:3], sign_transfer(visit.key, chain_id=chain_id, root=visit.owner)],
        [*arguments[:3], sign_transfer(new, chain_id=chain_id, root=elsewhere.owner)],
        [*arguments[:3], sign_transfer(new, chain_id=bytes(32), root=visit.owner)],
        [*arguments[:3], bytes(65)],
        [*arguments[:3], b""],
    ]
    for said in forged:
        assert hospital.send(visit.key, "records", "transfer", *said).code == "TRANSFER_SIGNATURE_WRONG"
    assert hospital.view("records", "current_of", visit.owner) == visit.owner
    robot = hospital.robot.identity
    assert hospital.send(robot, "records", "open_visit", hers.public_key, *arguments[1:3], hospital.bucket(), "care").ok


def test_who_has_no_visit_transfers_none(hospital: Hospital, visit: Visit) -> None:
    _, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA)
    for key in (key_of("stranger"), visit.robot.identity, hospital.enrol("cleo").identity):
        assert hospital.send(key, "records", "transfer", *arguments).code == "VISIT_UNKNOWN"


def test_a_visit_is_transferred_64_times_at_most(hospital: Hospital, visit: Visit) -> None:
    """Every wallet reads every announcement: nobody may make the others read without end."""
    key = visit.key
    for number in range(64):
        key = hospital.transfer(visit, NEW_ANNA, 100 + number, key)
    _, arguments = hospital.transfer_arguments(visit.owner, NEW_ANNA, 1000)
    assert hospital.send(key, "records", "transfer", *arguments).code == "TRANSFERS_TOO_MANY"
    hospital.must(key, "access", "request", [], "own-access")


def test_no_other_contract_transfers_in_somebodys_name() -> None:
    body = read_source("records").split("def transfer(", 1)[1]
    assert body.index('"CALL_INDIRECT"') < body.index("state.")
