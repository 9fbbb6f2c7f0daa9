"""The audit trail: complete, in order, one visit at a time, written by the deciding contracts only."""

from __future__ import annotations

from consensus.primitives.encoding import u32
from tests.unit.contracts.privacy.hospital import Hospital


def test_a_visits_story_is_told_in_order(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    record_id = hospital.record(visit)
    hospital.must(hospital.robot.identity, "records", "close_visit", visit.owner, 1)
    asked = hospital.must(visit.key, "access", "request", [record_id], "own-access")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, [record_id])
    hospital.must(visit.key, "access", "verdict", [[record_id, "verified", []]])
    erased = hospital.must(visit.key, "erasure", "request", [record_id], [])
    hospital.receipts_of_all(erased.txid)
    story = hospital.view("audit", "events", visit.owner, 0, 100)
    assert [entry["kind"] for entry in story] == [
        "visit_opened",
        "recorded",
        "visit_closed",
        "access_requested",
        "access_released",
        "verdict",
        "erasure_requested",
        "erasure_receipted",
        "erasure_receipted",
        "erasure_complete",
    ]
    assert [entry["record_id"] for entry in story[:3]] == [b"", record_id, b""]
    assert story[3]["data"] == {"access_id": asked.txid, "records": 1, "purpose": "own-access"}
    assert story[-1]["data"] == {"erasure_id": erased.txid}
    assert [entry["height"] for entry in story] == sorted(entry["height"] for entry in story)
    assert hospital.value("audit", b"count/" + visit.owner) == len(story)
    assert hospital.value("audit", b"entry/" + visit.owner + u32(4)) == story[4]


def test_the_audit_is_written_by_calls_that_succeed_and_by_nobody_directly(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    hospital.send(visit.key, "access", "request", [bytes(16)], "own-access")
    assert hospital.value("audit", b"count/" + visit.owner) == 1
    everyone = [visit.key, hospital.robot.identity, hospital.registrar, hospital.admin, *hospital.custodians]
    for key in everyone:
        receipt = hospital.send(key, "audit", "append", visit.owner, b"", "recorded", {})
        assert receipt.code == "NOT_AN_AUDITED_CONTRACT"
    assert hospital.value("audit", b"count/" + visit.owner) == 1


def test_events_are_read_in_pages(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(5):
        hospital.record(visit)
    whole = hospital.view("audit", "events", visit.owner, 0, 1000)
    paged = [entry for start in range(0, 6, 2) for entry in hospital.view("audit", "events", visit.owner, start, 2)]
    assert paged == whole
    assert hospital.view("audit", "events", visit.owner, 6, 2) == []
