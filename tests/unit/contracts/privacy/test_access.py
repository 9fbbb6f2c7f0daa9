"""Stories of access: asked for by the owner, answered by custodians, judged by the owner."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.contracts.privacy.hospital import Hospital, Visit, data_of


def test_an_owner_asks_and_custodians_release(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "access", "request", visit.records[:2], "own-access")
    assert data_of(asked, "requested") == {
        "access_id": asked.txid,
        "owner": visit.owner,
        "records": visit.records[:2],
        "purpose": "own-access",
    }
    custodian = hospital.custodians[0]
    released = hospital.must(custodian, "access", "released", asked.txid, visit.records[:1])
    assert data_of(released, "released") == {
        "access_id": asked.txid,
        "custodian": custodian.public_key,
        "records": visit.records[:1],
    }
    hospital.must(custodian, "access", "released", asked.txid, visit.records[1:2])
    state = hospital.view("access", "get", asked.txid)
    assert state["released"] == {custodian.public_key: 2}
    unasked = hospital.send(custodian, "access", "released", asked.txid, visit.records[2:])
    assert unasked.code == "RECORD_NOT_REQUESTED"


def test_no_record_named_means_the_whole_visit(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, visit.records)
    other = hospital.open_visit(hospital.enrol("ben"))
    foreign = hospital.record(other)
    receipt = hospital.send(hospital.custodians[0], "access", "released", asked.txid, [foreign])
    assert receipt.code == "NOT_THE_OWNER"


def test_a_custodian_that_says_the_same_again_is_not_heard_twice(hospital: Hospital, visit: Visit) -> None:
    """Restarted, it may not know what it sent already: the audit still shows one release, and one refusal."""
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    first, second = hospital.custodians[:2]
    for custodian in (first, second):
        hospital.must(custodian, "access", "released", asked.txid, visit.records)
        again = hospital.send(custodian, "access", "released", asked.txid, visit.records)
        assert again.code == "RELEASE_EXISTS"
    hospital.must(second, "access", "refused", asked.txid, "CLIP_ERASED")
    assert hospital.send(second, "access", "refused", asked.txid, "CLIP_ERASED").code == "REFUSAL_EXISTS"
    state = hospital.view("access", "get", asked.txid)
    assert state["released"] == {first.public_key: 3, second.public_key: 3}
    kinds = [event["kind"] for event in hospital.view("audit", "events", visit.owner, 0, 100)]
    assert (kinds.count("access_released"), kinds.count("access_refused")) == (2, 1)


def test_a_custodian_refuses_with_a_reason(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    refused = hospital.must(hospital.custodians[1], "access", "refused", asked.txid, "CLIP_ERASED")
    assert data_of(refused, "refused")["code"] == "CLIP_ERASED"
    assert hospital.send(hospital.custodians[1], "access", "refused", asked.txid, "").code == "CODE_WRONG"
    assert hospital.send(hospital.custodians[1], "access", "refused", bytes(32), "X").code == "ACCESS_UNKNOWN"


@pytest.mark.parametrize(
    ("records", "purpose", "code"),
    [
        ([bytes(16)], "own-access", "RECORD_UNKNOWN"),
        ([b"short"], "own-access", "RECORD_ID_WRONG"),
        (["text"], "own-access", "RECORD_ID_WRONG"),
        ([bytes(16)] * 65, "own-access", "RECORDS_TOO_MANY"),
        ([], "curiosity", "PURPOSE_UNKNOWN"),
    ],
)
def test_a_request_outside_the_limits_is_refused(
    hospital: Hospital, visit: Visit, records: list[Any], purpose: str, code: str
) -> None:
    assert hospital.send(visit.key, "access", "request", records, purpose).code == code


def test_nobody_sees_the_records_of_another(hospital: Hospital, visit: Visit) -> None:
    ben = hospital.enrol("ben")
    other = hospital.open_visit(ben)
    receipt = hospital.send(other.key, "access", "request", visit.records[:1], "own-access")
    assert receipt.code == "NOT_THE_OWNER"
    assert hospital.send(ben.identity, "access", "request", visit.records[:1], "own-access").code == "VISIT_UNKNOWN"


def test_an_owner_states_a_verdict(hospital: Hospital, visit: Visit) -> None:
    receipt = hospital.must(visit.key, "access", "verdict", visit.records[0], "corrupted", [1, 5])
    assert data_of(receipt, "verdict") == {
        "record_id": visit.records[0],
        "owner": visit.owner,
        "verdict": "corrupted",
        "frames": [1, 5],
    }
    assert hospital.view("access", "verdict_of", visit.records[0])["verdict"] == "corrupted"
    assert hospital.send(visit.key, "access", "verdict", visit.records[0], "nice", []).code == "VERDICT_UNKNOWN"
    assert hospital.send(visit.key, "access", "verdict", visit.records[0], "verified", [64]).code == "FRAMES_WRONG"
    assert hospital.send(visit.key, "access", "verdict", visit.records[0], "verified", [True]).code == "FRAMES_WRONG"


def test_what_is_being_erased_is_not_released_any_more(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    receipt = hospital.send(visit.key, "access", "request", visit.records[:1], "own-access")
    assert receipt.code == "RECORD_ERASED"


def test_sixty_four_records_fit_into_one_call(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(64):
        hospital.record(visit)
    asked = hospital.must(visit.key, "access", "request", visit.records, "own-access")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, visit.records)
