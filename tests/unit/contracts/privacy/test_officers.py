"""Two officers together erase what a robot recorded in a span of minutes, for somebody whose key is lost for good."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.encoding import encode_value
from consensus.rights.right_codes import (
    LOST_KEY_APPROVE_MS,
    LOST_KEY_CARRY_OUT_MS,
    LOST_KEY_REASONS,
    LOST_KEY_SPAN_MAX_MS,
    LOST_KEY_VISITS_MAX_COUNT,
)
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit, data_of

BUCKET_MS = 300_000


class Pair:
    """Two officers, and a visit in a span that is over."""

    def __init__(self, hospital: Hospital, visit: Visit) -> None:
        self.hospital, self.visit = hospital, visit
        self.first, self.second = hospital.enrol("first", "officer"), hospital.enrol("second", "officer")
        self.span = [visit.robot.identity.public_key, visit.bucket_ms, visit.bucket_ms + BUCKET_MS]
        hospital.time_ms = self.span[2]

    def propose(self, visits_max: int = 1, reason: str = "key-lost") -> bytes:
        proposed = self.hospital.must(self.first.identity, "officers", "propose", *self.span, reason, visits_max)
        return proposed.txid

    def agree(self, visits_max: int = 1) -> bytes:
        proposal_id = self.propose(visits_max)
        self.hospital.must(self.second.identity, "officers", "approve", proposal_id)
        return proposal_id

    def refusal(self, person: Person, entry: str, *arguments: Any) -> str:
        receipt = self.hospital.send(person.identity, "officers", entry, *arguments)
        assert not receipt.ok
        return receipt.code

    def erasing(self, proposal_id: bytes, visit: Visit | None = None) -> str:
        """How the chain answers if the first officer orders all records of a visit to be erased."""
        chosen = visit or self.visit
        arguments = (proposal_id, chosen.owner, chosen.records)
        return self.hospital.send(self.first.identity, "officers", "erase", *arguments).code


@pytest.fixture
def pair(hospital: Hospital, visit: Visit) -> Pair:
    return Pair(hospital, visit)


def move(hospital: Hospital, person: Person, **changes: Any) -> None:
    """Change what the registry says of somebody."""
    key = b"member/" + person.identity.public_key
    value = encode_value(hospital.value("identity", key) | changes)
    hospital.state.absorb({b"identity\x00" + key: value}, {}, hospital.state.state_root)


def test_two_officers_erase_together_and_it_stands_in_the_audit_of_the_visit(pair: Pair) -> None:
    hospital, visit = pair.hospital, pair.visit
    proposal_id = pair.agree()
    ordered = hospital.must(pair.second.identity, "officers", "erase", proposal_id, visit.owner, visit.records)
    assert data_of(ordered, "ordered")["records"] == 3
    assert data_of(ordered, "requested")["owner"] == visit.owner, "custodians hear of it as of any erasure"
    hospital.receipts_of_all(ordered.txid)
    assert {hospital.view("records", "get", record_id)["status"] for record_id in visit.records} == {"erased"}
    told = [event for event in hospital.view("audit", "events", visit.owner, 0, 50) if event["kind"] != "recorded"]
    assert [event["kind"] for event in told][1:3] == ["erased_by_officers", "erasure_requested"]
    officers = [pair.first.identity.public_key, pair.second.identity.public_key]
    assert told[1]["data"] == {"proposal_id": proposal_id, "reason": "key-lost", "officers": officers, "records": 3}
    entry = hospital.view("officers", "proposal", proposal_id)
    assert (entry["visits"], entry["records"], entry["status"], entry["org"]) == (1, 3, "approved", "ward")
    assert hospital.view("officers", "proposals", 0, 10) == [proposal_id]


def test_one_person_alone_erases_nothing(pair: Pair) -> None:
    hospital, proposal_id = pair.hospital, pair.propose()
    assert pair.erasing(proposal_id) == "NOT_APPROVED"
    assert pair.refusal(pair.first, "approve", proposal_id) == "OFFICER_THE_SAME"
    old, new = pair.first, Person("first-again")
    hospital.must(old.identity, "identity", "rotate", *hospital.rotation_arguments(old, new))
    assert pair.refusal(new, "approve", proposal_id) == "OFFICER_THE_SAME", "new keys make no second person"
    hospital.must(pair.second.identity, "officers", "approve", proposal_id)
    hospital.must(new.identity, "officers", "erase", proposal_id, pair.visit.owner, pair.visit.records)


def test_nobody_but_officers_of_that_robots_house_has_a_say(pair: Pair) -> None:
    hospital = pair.hospital
    other, staff = hospital.enrol("other", "officer"), hospital.enrol("nurse", "staff")
    move(hospital, other, org="elsewhere")
    proposal_id = pair.propose()
    for person in (other, staff, hospital.robot):
        assert pair.refusal(person, "propose", *pair.span, "key-lost", 1) == "NOT_AN_OFFICER"
        assert pair.refusal(person, "approve", proposal_id) == "NOT_AN_OFFICER"
        assert pair.refusal(person, "stop", proposal_id) == "NOT_AN_OFFICER"
        assert pair.refusal(person, "erase", proposal_id, pair.visit.owner, pair.visit.records) == "NOT_AN_OFFICER"


def test_only_the_two_who_decided_carry_it_out(pair: Pair) -> None:
    third = pair.hospital.enrol("third", "officer")
    arguments = (pair.agree(), pair.visit.owner, pair.visit.records)
    assert pair.refusal(third, "erase", *arguments) == "NOT_OF_THE_TWO"


def test_who_is_an_officer_no_more_has_agreed_to_nothing(pair: Pair) -> None:
    hospital, waiting, agreed = pair.hospital, pair.propose(), pair.agree()
    hospital.must(hospital.admin, "identity", "revoke", pair.first.handle)
    assert pair.refusal(pair.second, "approve", waiting) == "OFFICER_GONE"
    arguments = (agreed, pair.visit.owner, pair.visit.records)
    assert pair.refusal(pair.second, "erase", *arguments) == "OFFICER_GONE"


def test_a_proposal_waits_three_days_and_is_carried_out_within_seven(pair: Pair) -> None:
    hospital = pair.hospital
    late, in_time = pair.propose(), pair.propose()
    proposed_ms = hospital.view("officers", "proposal", in_time)["proposed_ms"]
    hospital.time_ms = proposed_ms + LOST_KEY_APPROVE_MS - 100
    hospital.must(pair.second.identity, "officers", "approve", in_time)
    assert hospital.time_ms == proposed_ms + LOST_KEY_APPROVE_MS
    hospital.time_ms += 1
    assert pair.refusal(pair.second, "approve", late) == "PROPOSAL_LAPSED"
    hospital.time_ms = proposed_ms + LOST_KEY_APPROVE_MS + LOST_KEY_CARRY_OUT_MS
    assert pair.erasing(in_time) == "PROPOSAL_LAPSED"
    hospital.time_ms -= 200
    assert pair.erasing(in_time) == "OK"


def test_a_second_approval_and_a_stopped_proposal_are_refused(pair: Pair) -> None:
    hospital, agreed, waiting = pair.hospital, pair.agree(), pair.propose()
    assert pair.refusal(pair.second, "approve", agreed) == "PROPOSAL_DECIDED"
    third = hospital.enrol("third", "officer")
    for proposal_id in (agreed, waiting):
        assert data_of(hospital.must(third.identity, "officers", "stop", proposal_id), "stopped")
    assert pair.erasing(agreed) == "NOT_APPROVED"
    assert pair.refusal(pair.second, "approve", waiting) == "PROPOSAL_DECIDED"
    assert pair.refusal(pair.second, "stop", agreed) == "PROPOSAL_DECIDED"


def test_nothing_outside_of_robot_and_span_goes(pair: Pair) -> None:
    hospital = pair.hospital
    ben, other_robot = hospital.enrol("ben"), hospital.enrol("robot-2", "robot")
    later = hospital.open_visit(ben, 1)
    elsewhere = hospital.open_visit(ben, 2, other_robot)
    for visit in (later, elsewhere):
        hospital.record(visit)
    proposal_id = pair.agree(visits_max=8)
    for visit in (later, elsewhere):
        assert pair.erasing(proposal_id, visit) == "VISIT_ELSEWHERE"
    nobody = bytes(33)
    assert pair.refusal(pair.first, "erase", proposal_id, nobody, pair.visit.records) == "VISIT_UNKNOWN"
    assert pair.refusal(pair.first, "erase", proposal_id, b"x", pair.visit.records) == "VISIT_UNKNOWN"
    foreign = (proposal_id, pair.visit.owner, later.records)
    assert pair.refusal(pair.first, "erase", *foreign) == "NOT_THE_OWNER"


def test_no_more_visits_go_than_were_approved_but_each_in_as_many_parts_as_it_takes(
    hospital: Hospital, visit: Visit
) -> None:
    other = hospital.open_visit(hospital.enrol("ben"))
    hospital.record(other)
    pair = Pair(hospital, visit)
    proposal_id = pair.agree(visits_max=1)
    for record_id in visit.records:
        hospital.must(pair.first.identity, "officers", "erase", proposal_id, visit.owner, [record_id])
    assert pair.erasing(proposal_id, other) == "VISITS_TOO_MANY"
    entry = hospital.view("officers", "proposal", proposal_id)
    assert (entry["visits"], entry["records"]) == (1, 3)


@pytest.mark.parametrize("ground", ["accuracy", "legal-claim", "objection", "unlawful"])
def test_what_its_owner_restricted_stays(pair: Pair, ground: str) -> None:
    hospital, visit = pair.hospital, pair.visit
    proposal_id = pair.agree()
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], ground)
    assert pair.erasing(proposal_id) == "RECORD_RESTRICTED"
    hospital.must(pair.first.identity, "officers", "erase", proposal_id, visit.owner, visit.records[1:])
    if ground in ("accuracy", "objection"):
        hospital.must(visit.key, "rights", "lift", [])
    hospital.must(visit.key, "rights", "restrict", [], ground)
    assert pair.refusal(pair.first, "erase", proposal_id, visit.owner, visit.records[:1]) == "RECORD_RESTRICTED"


def test_a_denied_visit_is_left_to_its_breach(pair: Pair) -> None:
    proposal_id = pair.agree()
    pair.hospital.must(pair.visit.key, "rights", "wrong_person")
    assert pair.erasing(proposal_id) == "VISIT_QUARANTINED"


def test_what_was_erased_before_is_not_erased_again(pair: Pair) -> None:
    proposal_id = pair.agree()
    assert pair.erasing(proposal_id) == "OK"
    assert pair.erasing(proposal_id) == "RECORD_ERASED"
    assert pair.hospital.view("officers", "proposal", proposal_id)["records"] == 3, "a refused order counts nothing"


@pytest.mark.parametrize(
    ("start", "length", "code"),
    [
        (1, BUCKET_MS, "SPAN_WRONG"),
        (0, BUCKET_MS - 1, "SPAN_WRONG"),
        (0, 0, "SPAN_WRONG"),
        (0, -BUCKET_MS, "SPAN_WRONG"),
        (-LOST_KEY_SPAN_MAX_MS, LOST_KEY_SPAN_MAX_MS + BUCKET_MS, "SPAN_WRONG"),
        (BUCKET_MS, BUCKET_MS, "SPAN_WRONG"),
        (-10 * LOST_KEY_SPAN_MAX_MS, LOST_KEY_SPAN_MAX_MS, "OK"),
    ],
)
def test_a_span_is_of_minutes_and_over(pair: Pair, start: int, length: int, code: str) -> None:
    robot, from_ms, _ = pair.span
    arguments = (robot, from_ms + start, from_ms + start + length, "key-lost", 1)
    assert pair.hospital.send(pair.first.identity, "officers", "propose", *arguments).code == code


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"reason": "so-it-seems"}, "REASON_UNKNOWN"),
        ({"visits_max": 0}, "VISITS_WRONG"),
        ({"visits_max": LOST_KEY_VISITS_MAX_COUNT + 1}, "VISITS_WRONG"),
        ({"robot": b"x"}, "ROBOT_UNKNOWN"),
        ({"robot": bytes(33)}, "ROBOT_UNKNOWN"),
    ],
)
def test_a_proposal_speaks_in_published_codes(pair: Pair, changes: dict[str, Any], code: str) -> None:
    values = dict(zip(("robot", "from_ms", "until_ms"), pair.span, strict=True))
    values |= {"reason": "key-lost", "visits_max": 1} | changes
    assert pair.refusal(pair.first, "propose", *values.values()) == code
    subject = pair.first.identity.public_key
    assert pair.refusal(pair.first, "propose", subject, *pair.span[1:], "key-lost", 1) == "ROBOT_UNKNOWN"
    for unknown in (bytes(32), b"x"):
        assert pair.refusal(pair.first, "approve", unknown) == "PROPOSAL_UNKNOWN"


def test_a_robot_that_was_taken_away_still_has_its_house(pair: Pair) -> None:
    pair.hospital.must(pair.hospital.admin, "identity", "revoke", pair.hospital.robot.handle)
    assert pair.erasing(pair.agree()) == "OK"


def test_wallet_and_contract_know_the_same_bounds() -> None:
    source = read_source("officers")
    assert f"REASONS = {tuple(sorted(LOST_KEY_REASONS))}\n".replace("'", '"') in source
    for name, value in (
        ("APPROVE_MS", LOST_KEY_APPROVE_MS),
        ("CARRY_OUT_MS", LOST_KEY_CARRY_OUT_MS),
        ("SPAN_MAX_MS", LOST_KEY_SPAN_MAX_MS),
        ("VISITS_MAX_COUNT", LOST_KEY_VISITS_MAX_COUNT),
    ):
        assert f"\n{name} = {value}\n" in source
