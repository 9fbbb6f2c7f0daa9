"""Stories of the rights of the recorded person: restriction, objection, correction, and denial of a visit."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.limits import CALL_GAS_MAX
from consensus.primitives.encoding import encode_value
from consensus.rights.right_codes import (
    BREACH_NOTIFY_MS,
    CORRECTIONS,
    DELAY_REASONS,
    GROUNDS,
    KEEP_MS,
    KEEPING_GROUNDS,
    OUTCOMES,
    OWN_PURPOSES,
    REASONS,
    RECIPIENTS,
    RISKS,
)
from consensus.state.consent import effective_consent, read_choices
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Visit, data_of

HOUR_MS = 3600 * 1000


def kinds(hospital: Hospital, visit: Visit) -> list[str]:
    return [entry["kind"] for entry in hospital.view("audit", "events", visit.owner, 0, 100)]


def test_the_contract_knows_the_published_codes_and_times() -> None:
    source = read_source("rights")
    for name, codes in (
        ("GROUNDS", GROUNDS),
        ("KEEPING_GROUNDS", KEEPING_GROUNDS),
        ("OWN_PURPOSES", OWN_PURPOSES),
        ("CORRECTIONS", CORRECTIONS),
        ("RISKS", RISKS),
        ("RECIPIENTS", RECIPIENTS),
        ("OUTCOMES", OUTCOMES),
        ("DELAY_REASONS", DELAY_REASONS),
    ):
        assert f"{name} = {tuple(sorted(codes))!r}".replace("'", '"') in source, name
    listed = source.split("REASONS = (", 1)[1].split(")", 1)[0]
    assert [line.strip(' ",\n') for line in listed.strip().splitlines()] == sorted(REASONS)
    assert (f"KEEP_MS = {KEEP_MS}\n" in source, f"NOTIFY_MS = {BREACH_NOTIFY_MS}\n" in source) == (True, True)


# Restriction


def test_a_restricted_record_is_asked_for_by_its_person_alone(hospital: Hospital, visit: Visit) -> None:
    first, second = visit.records[:2]
    hospital.must(visit.key, "rights", "restrict", [first], "accuracy")
    for records in ([first], [], [second, first]):
        assert hospital.send(visit.key, "access", "request", records, "research").code == "RECORD_RESTRICTED"
    hospital.must(visit.key, "access", "request", [second], "research")
    for purpose in OWN_PURPOSES:
        hospital.must(visit.key, "access", "request", [first], purpose)
    hospital.must(visit.key, "rights", "lift", [first])
    hospital.must(visit.key, "access", "request", [first], "research")
    assert kinds(hospital, visit).count("restriction_lifted") == 1
    assert hospital.view("rights", "restriction", visit.owner) is None


def test_a_whole_visit_is_restricted_with_what_is_still_to_come(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "restrict", [], "accuracy")
    late = hospital.record(visit)
    assert hospital.send(visit.key, "access", "request", [late], "care").code == "RECORD_RESTRICTED"
    assert hospital.send(visit.key, "rights", "lift", [late]).code == "RESTRICTED_WHOLE"
    hospital.must(visit.key, "rights", "lift", [])
    hospital.must(visit.key, "access", "request", [late], "care")


def test_custodians_hear_the_whole_restriction_each_time(hospital: Hospital, visit: Visit) -> None:
    first, second, _ = visit.records
    told = data_of(hospital.must(visit.key, "rights", "restrict", [first], "legal-claim"), "restricted")
    assert (told["owner"], told["records"], told["whole"]) == (visit.owner, [first], False)
    assert told["until_ms"] == hospital.time_ms + KEEP_MS
    told = data_of(hospital.must(visit.key, "rights", "restrict", [second], "unlawful"), "restricted")
    assert told["records"] == [first, second]
    told = data_of(hospital.must(visit.key, "rights", "lift", [first]), "lifted")
    assert (told["records"], told["until_ms"] > 0) == ([second], True)
    told = data_of(hospital.must(visit.key, "rights", "lift", []), "lifted")
    assert (told["records"], told["whole"], told["until_ms"]) == ([], False, 0)


def test_what_is_kept_for_a_claim_does_not_expire_until_it_is_lifted(hospital: Hospital, visit: Visit) -> None:
    first, second = visit.records[:2]
    hospital.must(visit.key, "rights", "restrict", [first], "legal-claim")
    custodian = hospital.custodians[0]
    hospital.time_ms += 31 * DAY_MS
    assert hospital.send(custodian, "erasure", "expired", [second, first], bytes(32)).code == "RECORD_RESTRICTED"
    hospital.must(custodian, "erasure", "expired", [second], bytes(32))
    hospital.must(visit.key, "rights", "lift", [first])
    hospital.must(custodian, "erasure", "expired", [first], bytes(32))


@pytest.mark.parametrize("ground", sorted(set(GROUNDS) - set(KEEPING_GROUNDS)))
def test_other_grounds_keep_nothing_beyond_its_time(hospital: Hospital, visit: Visit, ground: str) -> None:
    hospital.must(visit.key, "rights", "restrict", [], ground)
    hospital.time_ms += 31 * DAY_MS
    hospital.must(hospital.custodians[0], "erasure", "expired", visit.records, bytes(32))


def test_keeping_ends_after_a_year_unless_it_is_said_again(hospital: Hospital, visit: Visit) -> None:
    first, second = visit.records[:2]
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    hospital.time_ms += KEEP_MS - HOUR_MS
    hospital.must(visit.key, "rights", "restrict", [first], "legal-claim")
    hospital.time_ms += 2 * HOUR_MS
    refused = hospital.send(hospital.custodians[0], "erasure", "expired", [second], bytes(32))
    assert refused.code == "RECORD_RESTRICTED", "the whole visit is prolonged with it"
    hospital.time_ms += KEEP_MS
    hospital.must(hospital.custodians[0], "erasure", "expired", visit.records, bytes(32))


def test_a_whole_restriction_does_not_reach_back_to_what_had_expired(hospital: Hospital, visit: Visit) -> None:
    early = hospital.record(visit, 7, expires_at_ms=hospital.time_ms + DAY_MS)
    hospital.time_ms += 2 * DAY_MS
    assert hospital.send(visit.key, "rights", "restrict", [early], "accuracy").code == "RECORD_ERASED"
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    hospital.must(hospital.custodians[0], "erasure", "expired", [early], bytes(32))


def test_a_later_ground_does_not_reach_back_to_a_named_record_that_had_expired(
    hospital: Hospital, visit: Visit
) -> None:
    """Custodians have erased it by then: a chain that said it is kept would be told otherwise, and refuse to hear it."""
    early = hospital.record(visit, 7, expires_at_ms=hospital.time_ms + DAY_MS)
    hospital.must(visit.key, "rights", "restrict", [early], "accuracy")
    hospital.time_ms += 2 * DAY_MS
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], "legal-claim")
    assert hospital.view("rights", "restriction", visit.owner)["records"] == visit.records[:1]
    hospital.must(hospital.custodians[0], "erasure", "expired", [early], bytes(32))


def test_a_restriction_that_keeps_is_weakened_by_no_other_and_stops_no_erasure(
    hospital: Hospital, visit: Visit
) -> None:
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    assert hospital.send(visit.key, "rights", "restrict", [], "accuracy").code == "RESTRICTION_STANDS"
    hospital.must(visit.key, "rights", "restrict", [], "unlawful")
    asked = hospital.must(visit.key, "erasure", "request", visit.records[:1], [])
    hospital.receipts_of_all(asked.txid)
    assert hospital.view("records", "get", visit.records[0])["status"] == "erased"


@pytest.mark.parametrize(
    ("entry", "arguments", "code"),
    [
        ("restrict", [[], "because"], "GROUND_UNKNOWN"),
        ("restrict", [[bytes(16)], "accuracy"], "RECORD_UNKNOWN"),
        ("restrict", [[b"x"], "accuracy"], "RECORD_ID_WRONG"),
        ("restrict", [[bytes(16)] * 65, "accuracy"], "RECORDS_TOO_MANY"),
        ("lift", [[]], "NOT_RESTRICTED"),
        ("object_to_release", [[]], "CHOICE_MISSING"),
        ("object_to_release", [["own-access"]], "PURPOSE_OWN"),
        ("object_to_release", [["spying"]], "PURPOSE_UNKNOWN"),
        ("object_to_release", [["care"] * 17], "CHOICE_MISSING"),
        ("rectify", [[], "rumour", bytes(32)], "CORRECTION_UNKNOWN"),
        ("rectify", [[], "metadata", bytes(31)], "COMMITMENT_WRONG"),
    ],
)
def test_what_is_outside_the_limits_is_refused(
    hospital: Hospital, visit: Visit, entry: str, arguments: list[Any], code: str
) -> None:
    assert hospital.send(visit.key, "rights", entry, *arguments).code == code


def test_sixty_four_records_are_restricted_at_once_and_no_more_by_name(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(65):
        hospital.record(visit)
    hospital.must(visit.key, "rights", "restrict", visit.records[:64], "legal-claim")
    assert hospital.send(visit.key, "rights", "restrict", visit.records[64:], "unlawful").code == "RECORDS_TOO_MANY"
    hospital.must(visit.key, "rights", "restrict", [], "unlawful")
    hospital.time_ms += 31 * DAY_MS
    refused = hospital.send(hospital.custodians[0], "erasure", "expired", visit.records[:64], bytes(32))
    assert refused.code == "RECORD_RESTRICTED"
    hospital.must(visit.key, "rights", "lift", [])
    hospital.must(hospital.custodians[0], "erasure", "expired", visit.records[:64], bytes(32))


# Objection


def test_who_objects_is_recorded_no_more_for_that_purpose_by_any_sensor(hospital: Hospital) -> None:
    ben = hospital.enrol("ben")
    hospital.must(ben.identity, "consent", "give", ben.handle, ["care", "research"], ["rgb"], 0, 0, 0, hospital.height)
    receipt = hospital.must(ben.identity, "rights", "object_to", ben.handle, ["research"])
    told = data_of(receipt, "objected")
    member, height = ben.identity.public_key, hospital.height + 1
    assert told == {"member": member, "purposes": ["research"], "height": height, "mandate": b""}
    hospital.block([])
    choices = read_choices(hospital.value("consent", b"of/" + ben.handle))
    consented = {place for place, steps in choices.items() if effective_consent(steps, hospital.height)}
    assert consented == {("care", "depth"), ("care", "rgb"), ("demo", "depth")}
    assert choices["research", "rgb"][-1].status == "objected"


def test_an_objection_counts_where_nothing_was_given_and_outlasts_a_late_giving(hospital: Hospital) -> None:
    ben = hospital.enrol("ben")
    late = hospital.sign(ben.identity, "consent", "give", ben.handle, ["research"], ["rgb"], 0, 0, 0, hospital.height)
    hospital.must(ben.identity, "rights", "object_to", ben.handle, ["research"])
    assert hospital.block([late])[0].code == "WORD_OLDER"
    assert not hospital.view("consent", "allowed", ben.handle, "research", "rgb")


def test_an_objection_to_release_is_of_one_purpose(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "object_to_release", ["research", "teaching"])
    for purpose in ("research", "teaching"):
        assert hospital.send(visit.key, "access", "request", [], purpose).code == "PURPOSE_OBJECTED"
    hospital.must(visit.key, "access", "request", [], "care")
    assert sorted(hospital.view("rights", "objections", visit.owner)) == ["research", "teaching"]


# Correction


def test_corrections_are_linked_and_change_nothing(hospital: Hospital, visit: Visit) -> None:
    before = [hospital.view("records", "get", record_id) for record_id in visit.records]
    first = hospital.must(visit.key, "rights", "rectify", visit.records[:1], "attribution", b"1" * 32)
    second = hospital.must(visit.key, "rights", "rectify", [], "metadata", b"2" * 32)
    assert [hospital.view("records", "get", record_id) for record_id in visit.records] == before
    rows = hospital.view("rights", "corrections", visit.owner, 0, 10)
    assert [(row["kind"], row["commitment"], row["previous"], row["txid"]) for row in rows] == [
        ("attribution", b"1" * 32, b"", first.txid),
        ("metadata", b"2" * 32, first.txid, second.txid),
    ]
    assert kinds(hospital, visit).count("corrected") == 2


# Denial


def test_a_denied_visit_is_quarantined_and_its_clock_runs(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    receipt = hospital.must(visit.key, "rights", "wrong_person")
    told = data_of(receipt, "quarantined")
    assert (told["breach_id"], told["org"], told["due_ms"]) == (receipt.txid, "ward", hospital.time_ms + 72 * HOUR_MS)
    for entry, arguments in (
        ("restrict", [[], "accuracy"]),
        ("lift", [[]]),
        ("object_to_release", [["care"]]),
        ("rectify", [[], "metadata", bytes(32)]),
        ("wrong_person", []),
    ):
        assert hospital.send(visit.key, "rights", entry, *arguments).code == "VISIT_QUARANTINED", entry
    for purpose in (*OWN_PURPOSES, "care"):
        assert hospital.send(visit.key, "access", "request", visit.records[:1], purpose).code == "VISIT_QUARANTINED"
    assert hospital.send(visit.key, "erasure", "request", visit.records, []).code == "VISIT_QUARANTINED"
    assert hospital.view("rights", "restriction", visit.owner) is None
    assert hospital.view("rights", "breaches", 0, 10) == [receipt.txid]
    entry = hospital.view("rights", "breach", receipt.txid)
    assert (entry["status"], entry["robot"]) == ("opened", visit.robot.identity.public_key)


@pytest.fixture
def officer(hospital: Hospital) -> Any:
    return hospital.enrol("officer", "officer").identity


@pytest.fixture
def breach_id(hospital: Hospital, visit: Visit) -> bytes:
    return bytes(hospital.must(visit.key, "rights", "wrong_person").txid)


def test_a_breach_is_assessed_before_anything_else(hospital: Hospital, officer: Any, breach_id: bytes) -> None:
    for entry, arguments in (
        ("notify", ["authority", ""]),
        ("order_erasure", [[]]),
        ("close", ["released", "owner-confirmed"]),
    ):
        assert hospital.send(officer, "rights", entry, breach_id, *arguments).code == "BREACH_NOT_ASSESSED", entry


@pytest.mark.parametrize(
    ("risk", "needed"), [("none", []), ("risk", ["authority"]), ("high", ["authority", "subjects"])]
)
def test_a_breach_is_closed_once_those_were_told_whom_it_concerns(
    hospital: Hospital, visit: Visit, officer: Any, breach_id: bytes, risk: str, needed: list[str]
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, risk, "released-before")
    for recipient in needed:
        early = hospital.send(officer, "rights", "close", breach_id, "released", "owner-confirmed")
        assert early.code == "BREACH_NOT_NOTIFIED"
        hospital.must(officer, "rights", "notify", breach_id, recipient, "")
        assert hospital.send(officer, "rights", "notify", breach_id, recipient, "").code == "NOTIFIED_ALREADY"
    receipt = hospital.must(officer, "rights", "close", breach_id, "released", "owner-confirmed")
    assert data_of(receipt, "quarantine_ended")["owner"] == visit.owner
    hospital.must(visit.key, "access", "request", [], "own-access")
    assert hospital.send(officer, "rights", "assess", breach_id, "none", "owner-confirmed").code == "BREACH_CLOSED"
    told = [kind for kind in kinds(hospital, visit) if kind.startswith(("denied", "breach"))]
    assert told == ["denied", "breach_assessed", *["breach_notified"] * len(needed), "breach_closed"]


def test_after_72_hours_of_chain_time_the_delay_is_explained(
    hospital: Hospital, officer: Any, breach_id: bytes
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "risk", "tag-of-another")
    hospital.time_ms = hospital.view("rights", "breach", breach_id)["due_ms"]
    for reason in ("", "matched-wrongly"):
        receipt = hospital.send(officer, "rights", "notify", breach_id, "authority", reason)
        assert receipt.code == "DELAY_UNEXPLAINED"
    receipt = hospital.must(officer, "rights", "notify", breach_id, "authority", "officer-unreachable")
    assert data_of(receipt, "breach_notified")["late"] is True


def test_a_notification_in_time_needs_no_reason(hospital: Hospital, officer: Any, breach_id: bytes) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "risk", "tag-of-another")
    hospital.time_ms = hospital.view("rights", "breach", breach_id)["due_ms"] - 100
    receipt = hospital.must(officer, "rights", "notify", breach_id, "authority", "")
    assert data_of(receipt, "breach_notified")["late"] is False


def test_what_is_erased_by_an_officer_stays_in_quarantine(
    hospital: Hospital, visit: Visit, officer: Any, breach_id: bytes
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    asked = hospital.must(officer, "rights", "order_erasure", breach_id, visit.records)
    assert data_of(asked, "requested")["owner"] == visit.owner
    hospital.receipts_of_all(asked.txid)
    hospital.must(officer, "rights", "close", breach_id, "erased", "matched-wrongly")
    assert hospital.send(visit.key, "access", "request", [], "own-access").code == "VISIT_QUARANTINED"
    late = hospital.record(visit)
    assert hospital.send(visit.key, "access", "request", [late], "own-access").code == "VISIT_QUARANTINED"


def test_nothing_is_called_erased_while_a_record_is_still_there(
    hospital: Hospital, visit: Visit, officer: Any, breach_id: bytes
) -> None:
    ending = (officer, "rights", "close", breach_id, "erased", "matched-wrongly")
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    assert hospital.send(*ending).code == "RECORDS_LEFT"
    hospital.must(officer, "rights", "order_erasure", breach_id, visit.records[:2])
    assert hospital.send(*ending).code == "RECORDS_LEFT"
    hospital.must(officer, "rights", "order_erasure", breach_id, visit.records[2:])
    hospital.must(*ending)


def test_what_comes_after_the_end_can_be_erased_if_it_ended_so(
    hospital: Hospital, visit: Visit, officer: Any, breach_id: bytes
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    hospital.must(officer, "rights", "order_erasure", breach_id, visit.records)
    hospital.must(officer, "rights", "close", breach_id, "erased", "matched-wrongly")
    late = hospital.record(visit)
    asked = hospital.must(officer, "rights", "order_erasure", breach_id, [late])
    hospital.receipts_of_all(asked.txid)
    assert hospital.view("records", "get", late)["status"] == "erased"
    assert hospital.send(officer, "rights", "close", breach_id, "released", "owner-confirmed").code == "BREACH_CLOSED"


def test_nothing_more_is_erased_by_officers_once_a_visit_was_released(
    hospital: Hospital, visit: Visit, officer: Any, breach_id: bytes
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    hospital.must(officer, "rights", "close", breach_id, "released", "owner-confirmed")
    assert hospital.send(officer, "rights", "order_erasure", breach_id, visit.records).code == "BREACH_CLOSED"


def test_a_visit_of_many_records_can_be_ended_as_erased(hospital: Hospital, officer: Any) -> None:
    """What closing costs does not grow with the visit: nothing is walked over."""
    visit = hospital.open_visit(hospital.enrol("anna"))
    robot, gas = hospital.robot.identity, {}
    for count in (1, 2500):
        numbers = range(len(visit.records), count)
        recording = [hospital.record_arguments(visit, number) for number in numbers]
        for start in range(0, len(recording), 250):
            part = recording[start : start + 250]
            transactions = [hospital.sign(robot, "records", "record", *arguments) for arguments in part]
            assert all(receipt.ok for receipt in hospital.block(transactions))
        visit.records += [arguments[0] for arguments in recording]
        gas[count] = _close_as_erased(hospital, officer, visit)
        hospital.state.absorb(
            {b"rights\x00quarantine/" + visit.owner: None}, {}, hospital.state.state_root
        )  # so that it can be denied again
    assert gas[2500] < gas[1] + 1_000 < CALL_GAS_MAX / 20


def _close_as_erased(hospital: Hospital, officer: Any, visit: Visit) -> int:
    """Have what is left of a visit erased; return the gas of closing. Meanwhile it cannot be closed."""
    ending = (officer, "rights", "close")
    breach_id = hospital.must(visit.key, "rights", "wrong_person").txid
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    left = hospital.view("records", "of_visit", visit.owner)
    for start in range(0, len(left), 64):
        assert hospital.send(*ending, breach_id, "erased", "matched-wrongly").code == "RECORDS_LEFT"
        hospital.must(officer, "rights", "order_erasure", breach_id, left[start : start + 64])
    return hospital.must(*ending, breach_id, "erased", "matched-wrongly").gas_used


@pytest.mark.parametrize(("said", "lower"), [("high", "risk"), ("high", "none"), ("risk", "none")])
def test_a_risk_that_was_said_is_never_lowered(
    hospital: Hospital, officer: Any, breach_id: bytes, said: str, lower: str
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, said, "released-before")
    hospital.must(officer, "rights", "notify", breach_id, "authority", "")
    assert hospital.send(officer, "rights", "assess", breach_id, lower, "owner-confirmed").code == "RISK_LOWERED"
    hospital.must(officer, "rights", "assess", breach_id, said, "facts-came-late")
    assert hospital.view("rights", "breach", breach_id)["risk"] == said


def test_an_officer_of_another_house_has_no_say(hospital: Hospital, visit: Visit, breach_id: bytes) -> None:
    other = hospital.enrol("other-officer", "officer").identity
    place = b"identity\x00member/" + other.public_key
    moved = hospital.value("identity", b"member/" + other.public_key) | {"org": "elsewhere"}
    hospital.state.absorb({place: encode_value(moved)}, {}, hospital.state.state_root)
    for entry, arguments in (
        ("assess", ["none", "owner-confirmed"]),
        ("order_erasure", [visit.records]),
        ("close", ["released", "owner-confirmed"]),
    ):
        assert hospital.send(other, "rights", entry, breach_id, *arguments).code == "NOT_AN_OFFICER", entry


@pytest.mark.parametrize(
    ("entry", "arguments", "code"),
    [
        ("assess", ["terrible", "matched-wrongly"], "RISK_UNKNOWN"),
        ("assess", ["high", "so-it-seems"], "REASON_UNKNOWN"),
        ("notify", ["press", ""], "RECIPIENT_UNKNOWN"),
        ("close", ["forgotten", "owner-confirmed"], "OUTCOME_UNKNOWN"),
        ("close", ["released", ""], "REASON_UNKNOWN"),
        ("order_erasure", [[bytes(16)]], "RECORD_UNKNOWN"),
    ],
)
def test_an_officer_speaks_in_published_codes(
    hospital: Hospital, officer: Any, breach_id: bytes, entry: str, arguments: list[Any], code: str
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "matched-wrongly")
    assert hospital.send(officer, "rights", entry, breach_id, *arguments).code == code
    assert hospital.send(officer, "rights", entry, bytes(32), *arguments).code == "BREACH_UNKNOWN"
    assert hospital.send(officer, "rights", entry, b"x", *arguments).code == "BREACH_UNKNOWN"


def test_no_contract_speaks_in_a_persons_name() -> None:
    """Each entry that a person calls begins by refusing other contracts."""
    source = read_source("rights")
    for entry in ("restrict", "lift", "object_to_release", "rectify", "wrong_person"):
        body = source.split(f"def {entry}(", 1)[1].split("\n@export", 1)[0]
        assert body.index("require_owner(") < body.index("state."), entry
    assert source.split("def object_to(", 1)[1].index("require_direct()") < source.index("def object_to_release")
    assert "require_direct()" in source.split("def require_officer", 1)[1].split("def ", 1)[0]
