"""Stories of access: asked for by the owner, answered by custodians, judged by the owner."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import pytest

from consensus.limits import CALL_GAS_MAX
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Visit, data_of


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


def test_a_request_without_records_means_the_whole_visit_and_a_custodian_refuses_with_a_reason(
    hospital: Hospital, visit: Visit
) -> None:
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, sorted(visit.records))
    other = hospital.open_visit(hospital.enrol("ben"))
    foreign = hospital.record(other)
    receipt = hospital.send(hospital.custodians[0], "access", "released", asked.txid, [foreign])
    assert receipt.code == "NOT_THE_OWNER"
    refused = hospital.must(hospital.custodians[1], "access", "refused", asked.txid, "CLIP_ERASED")
    assert data_of(refused, "refused")["code"] == "CLIP_ERASED"
    assert hospital.send(hospital.custodians[1], "access", "refused", asked.txid, "").code == "CODE_WRONG"
    assert hospital.send(hospital.custodians[1], "access", "refused", bytes(32), "X").code == "ACCESS_UNKNOWN"


def test_a_custodian_that_says_the_same_again_is_not_heard_twice(hospital: Hospital, visit: Visit) -> None:
    """Restarted, it may not know what it sent already: the audit still shows one release, and one refusal."""
    asked = hospital.must(visit.key, "access", "request", [], "own-access")
    first, second = hospital.custodians[:2]
    for custodian in (first, second):
        hospital.must(custodian, "access", "released", asked.txid, sorted(visit.records))
        again = hospital.send(custodian, "access", "released", asked.txid, sorted(visit.records))
        assert again.code == "RELEASE_EXISTS"
    hospital.must(second, "access", "refused", asked.txid, "CLIP_ERASED")
    assert hospital.send(second, "access", "refused", asked.txid, "CLIP_ERASED").code == "REFUSAL_EXISTS"
    state = hospital.view("access", "get", asked.txid)
    assert state["released"] == {first.public_key: 3, second.public_key: 3}
    kinds = [event["kind"] for event in hospital.view("audit", "events", visit.owner, 0, 100)]
    assert (kinds.count("access_released"), kinds.count("access_refused")) == (2, 1)


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


def test_nobody_sees_the_records_of_another_nor_judges_them(hospital: Hospital, visit: Visit) -> None:
    ben = hospital.enrol("ben")
    other = hospital.open_visit(ben)
    receipt = hospital.send(other.key, "access", "request", visit.records[:1], "own-access")
    assert receipt.code == "NOT_THE_OWNER"
    assert hospital.send(ben.identity, "access", "request", visit.records[:1], "own-access").code == "VISIT_UNKNOWN"
    foreign = hospital.record(other)
    mixed = [[visit.records[0], "verified", []], [foreign, "corrupted", []]]
    assert hospital.send(visit.key, "access", "verdict", mixed).code == "NOT_THE_OWNER"
    assert hospital.view("access", "verdict_of", visit.records[0]) is None


def test_an_owner_states_a_verdict(hospital: Hospital, visit: Visit) -> None:
    finding = [visit.records[0], "corrupted", [1, 5]]
    receipt = hospital.must(visit.key, "access", "verdict", [finding])
    assert data_of(receipt, "verdict") == {"owner": visit.owner, "verdict": "corrupted", "findings": [finding]}
    assert hospital.view("access", "verdict_of", visit.records[0])["verdict"] == "corrupted"
    story = hospital.view("audit", "events", visit.owner, 0, 100)
    assert (story[-1]["kind"], story[-1]["record_id"]) == ("verdict", visit.records[0])


def test_what_was_found_of_a_whole_meeting_is_one_entry_of_the_audit(hospital: Hospital, visit: Visit) -> None:
    before = hospital.value("audit", b"count/" + visit.owner)
    findings = [[name, "verified", []] for name in visit.records]
    findings[1] = [visit.records[1], "corrupted", [3]]
    hospital.must(visit.key, "access", "verdict", findings)
    said = [hospital.view("access", "verdict_of", name)["verdict"] for name in visit.records]
    assert said == ["verified", "corrupted", "verified"]
    (entry,) = hospital.view("audit", "events", visit.owner, before, 100)
    assert (entry["record_id"], entry["data"]) == (b"", {"verdict": "corrupted", "findings": findings})


@pytest.mark.parametrize(
    ("findings", "code"),
    [
        (lambda name: [], "RECORDS_MISSING"),
        (lambda name: [[name, "verified", []]] * 65, "RECORDS_TOO_MANY"),
        (lambda name: [[name, "verified", []]] * 2, "RECORD_ID_WRONG"),
        (lambda name: [[name[:15], "verified", []]], "RECORD_ID_WRONG"),
        (lambda name: [["a", "verified", []]], "RECORD_ID_WRONG"),
        (lambda name: [[bytes(16), "verified", []]], "RECORD_UNKNOWN"),
        (lambda name: [name], "FINDING_WRONG"),
        (lambda name: [[name, "verified"]], "FINDING_WRONG"),
        (lambda name: [[name, "nice", []]], "VERDICT_UNKNOWN"),
        (lambda name: [[name, 1, []]], "VERDICT_UNKNOWN"),
        (lambda name: [[name, "verified", [64]]], "FRAMES_WRONG"),
        (lambda name: [[name, "verified", [-1]]], "FRAMES_WRONG"),
        (lambda name: [[name, "verified", [True]]], "FRAMES_WRONG"),
        (lambda name: [[name, "verified", 3]], "FRAMES_WRONG"),
        (lambda name: [[name, "verified", [0] * 65]], "FRAMES_WRONG"),
    ],
)
def test_a_verdict_that_is_none_is_refused_whole(
    hospital: Hospital, visit: Visit, findings: Callable[[bytes], list[Any]], code: str
) -> None:
    before = hospital.value("audit", b"count/" + visit.owner)
    assert hospital.send(visit.key, "access", "verdict", findings(visit.records[0])).code == code
    assert hospital.view("access", "verdict_of", visit.records[0]) is None
    assert hospital.value("audit", b"count/" + visit.owner) == before


def test_the_longest_verdict_is_within_the_gas_of_a_call(hospital: Hospital) -> None:
    """64 records with 64 changed pictures each: the most that one call may name."""
    visit = hospital.open_visit(hospital.enrol("anna"))
    names = [hospital.record(visit) for _ in range(64)]
    receipt = hospital.must(visit.key, "access", "verdict", [[name, "corrupted", list(range(64))] for name in names])
    assert receipt.gas_used <= CALL_GAS_MAX * 3 // 4


def test_sixty_four_records_fit_into_one_call(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(64):
        hospital.record(visit)
    asked = hospital.must(visit.key, "access", "request", visit.records, "own-access")
    receipt = hospital.must(hospital.custodians[0], "access", "released", asked.txid, sorted(visit.records))
    assert receipt.gas_used <= CALL_GAS_MAX * 3 // 4


def test_what_is_being_erased_is_not_released_any_more(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    receipt = hospital.send(visit.key, "access", "request", visit.records[:1], "own-access")
    assert receipt.code == "RECORD_ERASED"


def test_an_owner_asks_256_times_a_day_and_goes_on_the_next(hospital: Hospital, visit: Visit) -> None:
    ask = ("access", "request", visit.records[:1], "own-access")
    for _ in range(8):
        assert all(receipt.ok for receipt in hospital.block([hospital.sign(visit.key, *ask) for _ in range(32)]))
    assert hospital.send(visit.key, *ask).code == "WORDS_TOO_MANY"
    assert hospital.send(visit.key, "access", "verdict", [[visit.records[0], "verified", []]]).code == "WORDS_TOO_MANY"
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], "accuracy")
    hospital.must(visit.key, "erasure", "request", visit.records[1:2], [])
    hospital.time_ms += DAY_MS
    hospital.must(visit.key, "access", "request", visit.records[:1], "own-access")


@pytest.mark.parametrize("doubled", [True, False], ids=["one record twice", "not in order"])
def test_a_custodian_names_each_record_once_and_in_order(hospital: Hospital, visit: Visit, doubled: bool) -> None:
    asked = hospital.must(visit.key, "access", "request", visit.records, "own-access")
    named = [visit.records[0]] * 2 if doubled else sorted(visit.records, reverse=True)
    assert hospital.send(hospital.custodians[0], "access", "released", asked.txid, named).code == "RECORD_ID_WRONG"


def releases_in_audit(hospital: Hospital, visit: Visit) -> list[tuple[bytes, int]]:
    """The record named by each release in the trail (none if several), and of how many it is."""
    events = hospital.view("audit", "events", visit.owner, 0, 128)
    return [(each["record_id"], each["data"]["records"]) for each in events if each["kind"] == "access_released"]


@pytest.mark.parametrize("whole", [True, False], ids=["the whole visit", "these records"])
def test_of_what_a_custodian_names_only_what_it_had_not_named_is_written(
    hospital: Hospital, visit: Visit, whole: bool
) -> None:
    custodian, (first, second, third) = hospital.custodians[0], sorted(visit.records)
    asked = hospital.must(visit.key, "access", "request", [] if whole else visit.records, "own-access").txid
    for named in ([first], [first, second], [third]):
        hospital.must(custodian, "access", "released", asked, named)
    for named in ([second], [first, third], [first, second, third]):
        assert hospital.send(custodian, "access", "released", asked, named).code == "RELEASE_EXISTS"
    assert releases_in_audit(hospital, visit) == [(first, 1), (second, 1), (third, 1)]
    assert hospital.view("access", "get", asked)["released"] == {custodian.public_key: 3}


def test_pairs_of_a_whole_visit_make_no_longer_a_trail_than_its_records(hospital: Hospital, visit: Visit) -> None:
    for _ in range(5):
        hospital.record(visit)
    asked = hospital.must(visit.key, "access", "request", [], "own-access").txid
    pairs = combinations(sorted(visit.records), 2)
    codes = [hospital.send(hospital.custodians[0], "access", "released", asked, list(pair)).code for pair in pairs]
    assert (codes.count("OK"), len(codes)) == (len(visit.records) - 1, 28)
    assert sum(count for _, count in releases_in_audit(hospital, visit)) == len(visit.records)
