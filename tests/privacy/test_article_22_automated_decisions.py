"""GDPR Article 22: nothing is decided about a person by a machine alone.

What programs decide is whether a picture is kept, and they withhold it in doubt. (1) what is decided about a denial is
decided by an officer, and time alone decides nothing; (2) a robot decides nothing beyond its own visits:
`security/test_authorisation_entries.py`; (3) what it got wrong she contests by herself, and a person answers, with a
reason from a published list.
"""

from __future__ import annotations

from consensus.rights.right_codes import BREACH_NOTIFY_MS, REASONS
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Visit


def test_1_time_alone_decides_nothing_about_a_denial(hospital: Hospital, visit: Visit) -> None:
    breach_id = hospital.must(visit.key, "rights", "wrong_person").txid
    before = hospital.view("rights", "breach", breach_id)
    for wait_ms in (BREACH_NOTIFY_MS + 1, 365 * DAY_MS):
        hospital.time_ms += wait_ms
        hospital.block([])
        assert hospital.view("rights", "breach", breach_id) == before
        assert hospital.send(visit.key, "access", "request", [], "own-access").code == "VISIT_QUARANTINED"


def test_3_she_contests_it_and_a_person_answers_with_a_reason(hospital: Hospital, visit: Visit) -> None:
    breach_id = hospital.must(visit.key, "rights", "wrong_person").txid
    officer = hospital.enrol("officer", "officer").identity
    assert (
        hospital.send(officer, "rights", "assess", breach_id, "none", "the computer says so").code == "REASON_UNKNOWN"
    )
    hospital.must(officer, "rights", "assess", breach_id, "none", "matched-wrongly")
    hospital.must(officer, "rights", "close", breach_id, "released", "owner-confirmed")
    trail = {entry["kind"]: entry["data"] for entry in hospital.view("audit", "events", visit.owner, 0, 50)}
    for kind in ("breach_assessed", "breach_closed"):
        assert trail[kind]["officer"] == officer.public_key, "she reads who it was"
        assert trail[kind]["reason"] in REASONS
