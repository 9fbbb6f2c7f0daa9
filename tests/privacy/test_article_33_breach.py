"""GDPR Articles 33 and 34: a breach is notified within 72 hours, documented, and told to those concerned if need be.

Here the breach that the system itself can cause: a person's pictures in somebody else's wallet. (1) one word contains it
at once; (2) the clock is the chain's and begins with that word; (3) nobody but officers of the house concerned acts; (4)
it cannot be closed before those were told who have to be; (5) a late notification says why; (6) every step is documented
where the person who denied it reads it; (7) it ends by erasure or by a reason that is on the published list.
"""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.keys import PrivateKey
from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import BREACH_NOTIFY_MS, REASONS
from tests.offchain.conftest import house, make_store  # noqa: F401 - fixtures
from tests.offchain.house import ACCESS_ID, CustodianHarness, refused
from tests.offchain.small_chain import ALICE, access
from tests.offchain.test_standing import denied
from tests.unit.contracts.privacy.hospital import Hospital, Visit, key_of


@pytest.fixture
def breach_id(hospital: Hospital, visit: Visit) -> bytes:
    return bytes(hospital.must(visit.key, "rights", "wrong_person").txid)


def _step(hospital: Hospital, key: PrivateKey, entry: str, breach_id: bytes, *arguments: Any) -> str:
    return hospital.send(key, "rights", entry, breach_id, *arguments).code


def test_1_no_purpose_opens_it_for_anybody(hospital: Hospital, visit: Visit, breach_id: bytes) -> None:
    assert breach_id
    for purpose in PURPOSES:
        assert hospital.send(visit.key, "access", "request", [], purpose).code == "VISIT_QUARANTINED"


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_1_no_custodian_hands_it_out_under_what_was_open(house: CustodianHarness) -> None:  # noqa: F811
    async with house.open() as custodian:
        clip = await house.keep()
        await house.follow(access(ACCESS_ID, clip))
        await house.follow(denied())
        await refused("CLIP_QUARANTINED", custodian.download(clip.record_id, ACCESS_ID, ALICE))
        await refused("CLIP_QUARANTINED", custodian.export(clip.record_id))


def test_2_the_clock_is_the_chains(hospital: Hospital, breach_id: bytes) -> None:
    entry = hospital.view("rights", "breach", breach_id)
    assert (entry["opened_ms"], entry["due_ms"] - entry["opened_ms"]) == (hospital.time_ms, BREACH_NOTIFY_MS)
    assert BREACH_NOTIFY_MS == 72 * 3600 * 1000


def test_3_only_officers_act(hospital: Hospital, visit: Visit, breach_id: bytes) -> None:
    keys = [hospital.admin, hospital.registrar, hospital.robot.identity, visit.key, key_of("stranger")]
    keys += [hospital.enrol(role, role).identity for role in ("staff", "auditor")]
    for key in keys:
        assert _step(hospital, key, "assess", breach_id, "none", "owner-confirmed") == "NOT_AN_OFFICER"
        assert _step(hospital, key, "close", breach_id, "released", "owner-confirmed") == "NOT_AN_OFFICER"


def test_4_whom_it_concerns_is_told_before_it_is_closed(
    hospital: Hospital, visit: Visit, officer: PrivateKey, breach_id: bytes
) -> None:
    ending = ("close", breach_id, "erased", "matched-wrongly")
    assert _step(hospital, officer, *ending) == "BREACH_NOT_ASSESSED"
    hospital.must(officer, "rights", "assess", breach_id, "high", "released-before")
    for recipient in ("authority", "subjects"):
        assert _step(hospital, officer, *ending) == "BREACH_NOT_NOTIFIED"
        hospital.must(officer, "rights", "notify", breach_id, recipient, "")
    assert _step(hospital, officer, *ending) == "RECORDS_LEFT"
    hospital.must(officer, "rights", "order_erasure", breach_id, visit.records)
    assert _step(hospital, officer, *ending) == "OK"


def test_4_a_risk_that_turns_out_higher_is_told_to_more(
    hospital: Hospital, officer: PrivateKey, breach_id: bytes
) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "risk", "tag-of-another")
    hospital.must(officer, "rights", "notify", breach_id, "authority", "")
    hospital.must(officer, "rights", "assess", breach_id, "high", "released-before")
    assert _step(hospital, officer, "close", breach_id, "erased", "matched-wrongly") == "BREACH_NOT_NOTIFIED"


def test_5_a_late_notification_says_why(hospital: Hospital, officer: PrivateKey, breach_id: bytes) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "risk", "tag-of-another")
    hospital.time_ms += BREACH_NOTIFY_MS
    assert _step(hospital, officer, "notify", breach_id, "authority", "") == "DELAY_UNEXPLAINED"
    assert _step(hospital, officer, "notify", breach_id, "authority", "facts-came-late") == "OK"
    step = hospital.view("rights", "breach", breach_id)["notified"]["authority"]
    assert (step["late"], step["reason"], step["time"]) == (True, "facts-came-late", hospital.time_ms)


def test_6_every_step_is_documented(hospital: Hospital, visit: Visit, officer: PrivateKey, breach_id: bytes) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "risk", "tag-of-another")
    hospital.must(officer, "rights", "notify", breach_id, "authority", "")
    hospital.must(officer, "rights", "close", breach_id, "released", "owner-confirmed")
    trail = [entry for entry in hospital.view("audit", "events", visit.owner, 0, 50) if entry["height"] > 0]
    told = {entry["kind"]: entry for entry in trail}
    for kind in ("denied", "breach_assessed", "breach_notified", "breach_closed"):
        assert told[kind]["data"]["breach_id"] == breach_id
    assert told["breach_closed"]["data"]["officer"] == officer.public_key


def test_7_it_ends_by_erasure(hospital: Hospital, visit: Visit, officer: PrivateKey, breach_id: bytes) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "nothing-released")
    assert hospital.send(visit.key, "erasure", "request", visit.records, []).code == "VISIT_QUARANTINED"
    asked = hospital.must(officer, "rights", "order_erasure", breach_id, visit.records)
    hospital.receipts_of_all(asked.txid)
    hospital.must(officer, "rights", "close", breach_id, "erased", "matched-wrongly")
    assert {hospital.view("records", "get", record_id)["status"] for record_id in visit.records} == {"erased"}


def test_7_or_by_a_reason_of_the_list(hospital: Hospital, visit: Visit, officer: PrivateKey, breach_id: bytes) -> None:
    hospital.must(officer, "rights", "assess", breach_id, "none", "owner-confirmed")
    for reason in ("", "because", "x" * 200):
        assert _step(hospital, officer, "close", breach_id, "released", reason) == "REASON_UNKNOWN"
    assert all(sentence.endswith(".") for sentence in REASONS.values())
    hospital.must(officer, "rights", "close", breach_id, "released", "owner-confirmed")
    hospital.must(visit.key, "access", "request", [], "own-access")
