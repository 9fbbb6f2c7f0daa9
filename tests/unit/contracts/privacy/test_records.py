"""Stories of visits and records: opened, recorded, closed, found again by their owner alone."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.limits import RETENTION_MAX_MS, TIME_BUCKET_MS, VISIT_MAX_MS
from consensus.records.owner_keys import scan_announcement
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, data_of


def test_a_visit_is_announced_and_only_its_person_finds_it(hospital: Hospital) -> None:
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben")
    visit, arguments = hospital.visit_of(anna)
    receipt = hospital.must(hospital.robot.identity, "records", "open_visit", *arguments)
    event = data_of(receipt, "visit_opened")
    assert set(event) == {"owner", "ephemeral", "view_tag", "bucket_ms", "sequence"}
    assert (event["owner"], event["sequence"]) == (visit.owner, 0)
    (owner, ephemeral, view_tag, bucket_ms, robot) = hospital.view("records", "announcements", 0, 10)[0]
    assert (owner, bucket_ms, robot) == (visit.owner, visit.bucket_ms, hospital.robot.identity.public_key)
    where = {"chain_id": hospital.chain_id, "robot": robot}
    assert scan_announcement(anna.view, anna.spend.public_key, ephemeral, view_tag, **where) == owner
    assert scan_announcement(ben.view, ben.spend.public_key, ephemeral, view_tag, **where) != owner


def test_announcements_are_numbered_without_gaps(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    visits = [hospital.open_visit(anna, number) for number in range(5)]
    assert hospital.value("records", b"announcement-count") == 5
    found = hospital.view("records", "announcements", 0, 256)
    assert [item[0] for item in found] == [visit.owner for visit in visits]
    assert [item[0] for item in hospital.view("records", "announcements", 3, 1)] == [visits[3].owner]
    assert hospital.view("records", "announcements", 5, 10) == []
    assert len({visit.owner for visit in visits}) == 5


def test_a_record_commits_to_a_clip_and_says_so_to_custodians(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    arguments = hospital.record_arguments(visit)
    receipt = hospital.must(hospital.robot.identity, "records", "record", *arguments)
    assert data_of(receipt, "recorded") == {
        "record_id": arguments[0],
        "owner": visit.owner,
        "commitment_root": arguments[2],
        "ciphertext_root": arguments[3],
        "expires_at_ms": arguments[6],
        "robot": hospital.robot.identity.public_key,
    }
    record = hospital.view("records", "get", arguments[0])
    assert (record["owner"], record["status"], record["erased_frames"]) == (visit.owner, "active", [])
    assert (record["txid"], record["height"], record["sealed_metadata"]) == (
        receipt.txid,
        hospital.height,
        arguments[4],
    )
    assert hospital.view("records", "of_visit", visit.owner) == [arguments[0]]


def test_a_record_costs_little(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    receipt = hospital.must(hospital.robot.identity, "records", "record", *hospital.record_arguments(visit))
    assert receipt.gas_used < 5_000


def test_retention_may_be_long_but_not_for_ever(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    hospital.record(visit, 0, expires_at_ms=hospital.time_ms + RETENTION_MAX_MS)
    beyond = hospital.record_arguments(visit, 1, expires_at_ms=hospital.time_ms + RETENTION_MAX_MS + 101)
    assert hospital.send(hospital.robot.identity, "records", "record", *beyond).code == "EXPIRY_WRONG"


def test_a_visit_with_hundreds_of_records_is_listed_whole(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    transactions = [
        hospital.sign(hospital.robot.identity, "records", "record", *hospital.record_arguments(visit, number))
        for number in range(300)
    ]
    for start in range(0, 300, 100):
        assert all(receipt.ok for receipt in hospital.block(transactions[start : start + 100]))
    ids = hospital.view("records", "of_visit", visit.owner)
    assert ids == sorted(hospital.record_arguments(visit, number)[0] for number in range(300))


def test_closing_states_the_count_and_ends_the_recording(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    hospital.record(visit)
    receipt = hospital.must(hospital.robot.identity, "records", "close_visit", visit.owner, 1)
    assert data_of(receipt, "visit_closed") == {"owner": visit.owner, "record_count": 1}
    state = hospital.view("records", "visit", visit.owner)
    assert (state["status"], state["record_count"]) == ("closed", 1)
    late = hospital.send(hospital.robot.identity, "records", "record", *hospital.record_arguments(visit, 7))
    assert late.code == "VISIT_CLOSED"
    assert hospital.send(hospital.robot.identity, "records", "close_visit", visit.owner, 2).code == "VISIT_CLOSED"


def test_an_owner_key_serves_one_visit(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    hospital.open_visit(anna)
    _, again = hospital.visit_of(anna)
    assert hospital.send(hospital.robot.identity, "records", "open_visit", *again).code == "VISIT_EXISTS"


def test_a_record_id_serves_once(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    record_id = hospital.record(visit, 0)
    again = hospital.record_arguments(visit, 0, ciphertext_root=bytes(32))
    assert hospital.send(hospital.robot.identity, "records", "record", *again).code == "RECORD_EXISTS"
    assert hospital.view("records", "get", record_id)["ciphertext_root"] != bytes(32)


def test_a_robot_that_hears_of_an_id_before_it_is_final_cannot_take_it(hospital: Hospital) -> None:
    """With the same commitments either: the id follows from the owner key too, and whose that is, its visit says."""
    known = hospital.record_arguments(hospital.open_visit(hospital.enrol("anna")))
    visit = hospital.open_visit(hospital.enrol("ben"), robot=hospital.enrol("other robot", "robot"))
    for change in ({"record_id": known[0]}, {"record_id": known[0], "commitment_root": known[2]}):
        taken = hospital.record_arguments(visit, **change)
        assert hospital.send(visit.robot.identity, "records", "record", *taken).code == "RECORD_ID_WRONG"
    assert hospital.send(visit.robot.identity, "records", "record", *known).code == "NOT_THE_ROBOT"


@pytest.mark.parametrize(
    ("position", "value", "code"),
    [
        (0, bytes(32), "KEY_SIZE_WRONG"),
        (1, bytes(34), "KEY_SIZE_WRONG"),
        (2, 256, "VIEW_TAG_WRONG"),
        (2, -1, "VIEW_TAG_WRONG"),
        (4, "gossip", "PURPOSE_UNKNOWN"),
        (4, "", "PURPOSE_UNKNOWN"),
    ],
)
def test_a_visit_outside_the_limits_is_refused(hospital: Hospital, position: int, value: Any, code: str) -> None:
    _, arguments = hospital.visit_of(hospital.enrol("anna"))
    arguments[position] = value
    assert hospital.send(hospital.robot.identity, "records", "open_visit", *arguments).code == code


@pytest.mark.parametrize("offset_ms", [1, -60_000, 3 * TIME_BUCKET_MS, -DAY_MS - TIME_BUCKET_MS, -100 * DAY_MS])
def test_a_bucket_is_five_full_minutes_near_now(hospital: Hospital, offset_ms: int) -> None:
    _, arguments = hospital.visit_of(hospital.enrol("anna"))
    arguments[3] += offset_ms
    assert hospital.send(hospital.robot.identity, "records", "open_visit", *arguments).code == "BUCKET_WRONG"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"record_id": bytes(15)}, "RECORD_ID_WRONG"),
        ({"record_id": bytes(16)}, "RECORD_ID_WRONG"),
        ({"commitment_root": bytes(32)}, "RECORD_ID_WRONG"),
        ({"owner": bytes(33)}, "VISIT_UNKNOWN"),
        ({"commitment_root": bytes(31)}, "ROOT_WRONG"),
        ({"ciphertext_root": b""}, "ROOT_WRONG"),
        ({"sealed_metadata": bytes(559)}, "METADATA_WRONG"),
        ({"expires_at_ms": 0}, "EXPIRY_WRONG"),
        ({"expires_at_ms": 1 << 60}, "EXPIRY_WRONG"),
    ],
)
def test_a_record_outside_the_limits_is_refused(hospital: Hospital, change: dict[str, Any], code: str) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    arguments = hospital.record_arguments(visit, **change)
    assert hospital.send(hospital.robot.identity, "records", "record", *arguments).code == code


def test_a_visit_lasts_ten_minutes(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    hospital.time_ms += VISIT_MAX_MS
    hospital.record(visit, 0)
    hospital.time_ms += 2 * TIME_BUCKET_MS
    late = hospital.record_arguments(visit, 1)
    assert hospital.send(hospital.robot.identity, "records", "record", *late).code == "VISIT_TOO_LONG"
    early = hospital.record_arguments(visit, 2, bucket_ms=visit.bucket_ms - TIME_BUCKET_MS)
    assert hospital.send(hospital.robot.identity, "records", "record", *early).code == "VISIT_TOO_LONG"


def test_a_clip_that_waited_in_the_spool_is_still_recorded(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    visit, arguments = hospital.visit_of(anna)
    bucket_ms = hospital.bucket()
    hospital.time_ms += 3 * 3600 * 1000
    hospital.must(hospital.robot.identity, "records", "open_visit", *arguments)
    hospital.record(visit, 0, bucket_ms=bucket_ms)


def test_nothing_on_the_chain_joins_two_visits_of_one_person(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    hospital.record(hospital.open_visit(anna, 0))
    hospital.record(hospital.open_visit(anna, 1))
    secrets = (anna.handle, anna.identity.public_key, anna.spend.public_key, anna.view.public_key, anna.sealing)
    for prefix in (b"records\x00", b"audit\x00"):
        for key, value in hospital.state.scan(prefix, 10_000):
            assert not any(secret in key or secret in value for secret in secrets)
