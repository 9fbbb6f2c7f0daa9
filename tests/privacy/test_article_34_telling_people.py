"""GDPR Article 34: where the risk is high, the people themselves are told, and nobody can leave that out.

(1) a breach of high risk does not end before it is on the chain that they were told, by whom; (2) they can look it up in
the trail of the visit; (3) where the risk is not high it is not demanded: `unit/contracts/privacy/test_rights.py`. The
letter itself is written by people.
"""

from __future__ import annotations

from consensus.primitives.keys import PrivateKey
from consensus.rights.right_codes import RECIPIENTS, RISKS
from tests.unit.contracts.privacy.hospital import Hospital, Visit


def _assessed(hospital: Hospital, visit: Visit, officer: PrivateKey, risk: str) -> bytes:
    breach_id = bytes(hospital.must(visit.key, "rights", "wrong_person").txid)
    hospital.must(officer, "rights", "assess", breach_id, risk, "released-before")
    if risk != "none":
        hospital.must(officer, "rights", "notify", breach_id, "authority", "")
    return breach_id


def test_1_a_high_risk_does_not_end_before_they_were_told(
    hospital: Hospital, visit: Visit, officer: PrivateKey
) -> None:
    breach_id = _assessed(hospital, visit, officer, "high")
    ending = (officer, "rights", "close", breach_id, "erased", "matched-wrongly")
    assert hospital.send(*ending).code == "BREACH_NOT_NOTIFIED"
    assert hospital.send(hospital.admin, "rights", "notify", breach_id, "subjects", "").code == "NOT_AN_OFFICER"
    hospital.must(officer, "rights", "notify", breach_id, "subjects", "")
    hospital.must(officer, "rights", "order_erasure", breach_id, visit.records)
    hospital.must(*ending)


def test_2_they_can_look_it_up_in_the_trail(hospital: Hospital, visit: Visit, officer: PrivateKey) -> None:
    breach_id = _assessed(hospital, visit, officer, "high")
    hospital.must(officer, "rights", "notify", breach_id, "subjects", "")
    told = [
        entry for entry in hospital.view("audit", "events", visit.owner, 0, 50) if entry["kind"] == "breach_notified"
    ]
    assert [entry["data"]["recipient"] for entry in told] == ["authority", "subjects"]
    assert {entry["data"]["officer"] for entry in told} == {officer.public_key}
    assert "Art. 34" in RECIPIENTS["subjects"]
    assert "Art. 33 and 34" in RISKS["high"]
