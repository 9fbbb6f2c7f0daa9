"""Stories of erasure: frames, records, whole visits, and what expires by itself."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.keys import PrivateKey
from tests.unit.contracts.privacy.hospital import Hospital, Visit, data_of
from tests.unit.contracts.system import consortium
from tests.unit.contracts.system.consortium import node_fields


def test_a_record_is_erased_when_every_custodian_has_confirmed(hospital: Hospital, visit: Visit) -> None:
    record_id = visit.records[0]
    asked = hospital.must(visit.key, "erasure", "request", [record_id], [])
    assert data_of(asked, "requested") == {
        "erasure_id": asked.txid,
        "owner": visit.owner,
        "records": [record_id],
        "frames": [],
    }
    assert hospital.view("records", "get", record_id)["status"] == "erasing"

    told = [4, "backups of the host", 1_800_000_000_000, b"d" * 32]
    first = hospital.must(hospital.custodians[0], "erasure", "receipt", asked.txid, *told)
    assert data_of(first, "receipted")["status"] == "requested"
    assert hospital.view("records", "get", record_id)["commitment_root"] != b""

    second = hospital.must(hospital.custodians[1], "erasure", "receipt", asked.txid, *told)
    assert data_of(second, "receipted") == {
        "erasure_id": asked.txid,
        "custodian": hospital.custodians[1].public_key,
        "status": "complete",
    }
    record = hospital.view("records", "get", record_id)
    assert record["status"] == "erased"
    assert (record["commitment_root"], record["ciphertext_root"], record["sealed_metadata"]) == (b"", b"", b"")
    state = hospital.view("erasure", "get", asked.txid)
    assert state["status"] == "complete"
    assert state["receipts"][hospital.custodians[0].public_key]["remains_until_ms"] == 1_800_000_000_000
    assert hospital.view("records", "get", visit.records[1])["status"] == "active"


def test_frames_of_a_record_are_erased_and_the_rest_stays(hospital: Hospital, visit: Visit) -> None:
    record_id = visit.records[0]
    for frames in ([7, 3], [3, 1]):
        asked = hospital.must(visit.key, "erasure", "request", [record_id], frames)
        hospital.receipts_of_all(asked.txid, destroyed=2)
    record = hospital.view("records", "get", record_id)
    assert (record["status"], record["erased_frames"]) == ("active", [1, 3, 7])
    assert record["commitment_root"] != b""
    hospital.must(visit.key, "access", "request", [record_id], "own-access")


def test_a_whole_visit_is_erased_in_chunks_of_sixty_four(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(150):
        hospital.record(visit)
    for start in range(0, 150, 64):
        asked = hospital.must(visit.key, "erasure", "request", visit.records[start : start + 64], [])
        receipts = hospital.receipts_of_all(asked.txid)
        assert len(receipts[-1].events) <= 3
    statuses = {hospital.view("records", "get", record_id)["status"] for record_id in visit.records}
    assert statuses == {"erased"}


@pytest.mark.parametrize(
    ("records", "frames", "code"),
    [
        ([], [], "RECORDS_MISSING"),
        ([bytes(16)], [], "RECORD_UNKNOWN"),
        ([b"x"], [], "RECORD_ID_WRONG"),
        ([bytes(16), bytes(16)], [], "RECORD_ID_WRONG"),
        ([bytes(16), b"1" * 16], [1], "FRAMES_WRONG"),
        ([bytes(16)], [64], "FRAMES_WRONG"),
        ([bytes(16)], [-1], "FRAMES_WRONG"),
        ([bytes(16)], [0] * 65, "FRAMES_WRONG"),
        ([n.to_bytes(16, "big") for n in range(65)], [], "RECORDS_TOO_MANY"),
    ],
)
def test_a_request_outside_the_limits_is_refused(
    hospital: Hospital, visit: Visit, records: list[Any], frames: list[Any], code: str
) -> None:
    assert hospital.send(visit.key, "erasure", "request", records, frames).code == code


def test_a_record_is_erased_once(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    again = hospital.send(visit.key, "erasure", "request", visit.records[:2], [])
    assert again.code == "RECORD_ERASED"
    assert hospital.view("records", "get", visit.records[1])["status"] == "active"


def test_frames_that_are_erased_or_being_erased_are_not_asked_for_again(hospital: Hospital, visit: Visit) -> None:
    record_id, trail = visit.records[0], b"count/" + visit.owner
    asked = hospital.must(visit.key, "erasure", "request", [record_id], [0, 2])
    for confirmed in (False, True):
        if confirmed:
            hospital.receipts_of_all(asked.txid, destroyed=2)
        before = hospital.value("audit", trail)
        for frames in ([0], [2], [2, 0], [0, 0]):
            assert hospital.send(visit.key, "erasure", "request", [record_id], frames).code == "RECORD_ERASED"
        assert hospital.value("audit", trail) == before
    hospital.must(visit.key, "erasure", "request", [record_id], [0, 1])
    accepted = sum(hospital.send(visit.key, "erasure", "request", [record_id], [n % 64]).ok for n in range(130))
    assert accepted == 61, "each request names a frame that no other did"


def test_a_custodian_confirms_once_and_within_limits(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    custodian = hospital.custodians[0]
    for wrong in ([-1, "", 0, bytes(32)], [1, "x" * 257, 0, bytes(32)], [1, "", -1, bytes(32)], [1, "", 0, b""]):
        assert hospital.send(custodian, "erasure", "receipt", asked.txid, *wrong).code == "RECEIPT_WRONG"
    hospital.must(custodian, "erasure", "receipt", asked.txid, 1, "", 0, bytes(32))
    again = hospital.send(custodian, "erasure", "receipt", asked.txid, 1, "", 0, bytes(32))
    assert again.code == "RECEIPT_EXISTS"
    assert hospital.view("erasure", "get", asked.txid)["status"] == "requested"
    assert hospital.send(custodian, "erasure", "receipt", bytes(32), 1, "", 0, bytes(32)).code == "ERASURE_UNKNOWN"


def test_nobody_forges_a_receipt_and_no_custodian_speaks_for_another(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    said = (asked.txid, 3, "nothing", 0, bytes(32))
    for stranger in (visit.key, hospital.admin, PrivateKey(b"\x07" * 32)):
        assert hospital.send(stranger, "erasure", "receipt", *said).code == "NOT_A_CUSTODIAN"
    first = hospital.custodians[0]
    hospital.must(first, "erasure", "receipt", *said)
    assert hospital.send(first, "erasure", "receipt", *said).code == "RECEIPT_EXISTS"
    entry = hospital.view("erasure", "get", asked.txid)
    assert list(entry["receipts"]) == [first.public_key]
    assert entry["status"] == "requested", "the others have not spoken"


def test_expired_records_are_reduced_and_erased_by_all_custodians(hospital: Hospital, visit: Visit) -> None:
    hospital.time_ms = hospital.view("records", "get", visit.records[2])["expires_at_ms"]
    first, second = hospital.custodians
    receipt = hospital.must(first, "erasure", "expired", visit.records, bytes(32))
    assert data_of(receipt, "expired") == {"record_ids": visit.records, "custodian": first.public_key}
    record = hospital.view("records", "get", visit.records[0])
    assert (record["status"], record["commitment_root"]) == ("expired", b"")
    hospital.must(first, "erasure", "expired", visit.records, bytes(32))
    assert hospital.view("records", "get", visit.records[0])["status"] == "expired"
    hospital.must(second, "erasure", "expired", visit.records, bytes(32))
    assert hospital.view("records", "get", visit.records[0])["status"] == "erased"
    kinds = [entry["kind"] for entry in hospital.view("audit", "events", visit.owner, 0, 100)]
    assert kinds.count("expired") == 2


def test_nothing_expires_before_its_time(hospital: Hospital, visit: Visit) -> None:
    early = hospital.send(hospital.custodians[0], "erasure", "expired", visit.records, bytes(32))
    assert early.code == "RECORD_NOT_EXPIRED"
    assert hospital.view("records", "get", visit.records[0])["status"] == "active"


def test_sixty_four_expired_records_of_as_many_owners_fit_into_one_call(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    ids = [hospital.record(hospital.open_visit(anna, number)) for number in range(64)]
    hospital.time_ms += 31 * 24 * 3600 * 1000
    hospital.must(hospital.custodians[0], "erasure", "expired", ids, bytes(32))
    hospital.must(hospital.custodians[1], "erasure", "expired", ids, bytes(32))


class Clinic(Hospital):
    """One with three custodians."""

    custodian_names = ("custodian-1", "custodian-2", "custodian-3")


def test_a_record_is_erased_when_those_who_are_custodians_now_have_said_so() -> None:
    clinic = Clinic()
    visit = clinic.open_visit(clinic.enrol("anna"))
    record_id = clinic.record(visit)
    clinic.time_ms = clinic.view("records", "get", record_id)["expires_at_ms"]
    gone, first, silent = clinic.custodians
    for custodian in (gone, first):
        clinic.must(custodian, "erasure", "expired", [record_id], bytes(32))
    clinic.must(clinic.admin, "membership", "propose", "remove_node", {"name": "custodian-1"})
    clinic.must(first, "erasure", "expired", [record_id], bytes(32))
    assert clinic.view("records", "get", record_id)["status"] == "expired", "the third has said nothing"
    clinic.must(silent, "erasure", "expired", [record_id], bytes(32))
    assert clinic.view("records", "get", record_id)["status"] == "erased"


def test_who_goes_without_a_word_keeps_no_record_from_being_called_erased() -> None:
    clinic = Hospital()
    visit = clinic.open_visit(clinic.enrol("anna"))
    record_id = clinic.record(visit)
    clinic.time_ms = clinic.view("records", "get", record_id)["expires_at_ms"]
    first, silent = clinic.custodians
    clinic.must(first, "erasure", "expired", [record_id], bytes(32))
    clinic.must(clinic.admin, "membership", "propose", "remove_node", {"name": "custodian-2"})
    assert silent.public_key not in clinic.view("identity", "custodians")
    clinic.must(first, "erasure", "expired", [record_id], bytes(32))
    assert clinic.view("records", "get", record_id)["status"] == "erased"


def test_only_who_was_a_custodian_at_the_request_and_still_is_confirms_an_erasure() -> None:
    clinic = Clinic()
    visit = clinic.open_visit(clinic.enrol("anna"))
    asked = clinic.must(visit.key, "erasure", "request", [clinic.record(visit)], [])
    clinic.must(clinic.admin, "membership", "propose", "remove_node", {"name": "custodian-1"})
    clinic.must(clinic.admin, "membership", "propose", "add_node", node_fields("late", "ward", custodian=True))
    gone, late = clinic.custodians[0], consortium.key_of("late/custodian")
    assert late.public_key in clinic.view("identity", "custodians")
    for custodian in (gone, late):
        told = (asked.txid, 3, "nothing", 0, bytes(32))
        assert clinic.send(custodian, "erasure", "receipt", *told).code == "NOT_A_CUSTODIAN"
    assert clinic.view("erasure", "get", asked.txid)["receipts"] == {}
