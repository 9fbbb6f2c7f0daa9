"""GDPR Article 16: what is inaccurate is rectified, by a supplementary statement where that is what fits.

(1) a person says what is wrong, without anybody's leave; (2) it stands beside the record for as long as that is known;
(3) nothing that was recorded is changed by it; (4) nobody learns from the chain what she said; (5) whom she hands it to
can check that it was she who said it, and when. That the last word is linked to those before:
`unit/contracts/privacy/test_rights.py`.
"""

from __future__ import annotations

import secrets

from consensus.rights.right_codes import CORRECTION_SALT_BYTES, Correction, commit_correction
from tests.unit.contracts.privacy.hospital import Hospital, Visit, key_of


def _correction(visit: Visit, text: str, salt: bytes | None = None) -> Correction:
    salt = salt or secrets.token_bytes(CORRECTION_SALT_BYTES)
    return Correction("attribution", text, salt.hex(), visit.owner.hex(), [visit.records[0].hex()])


def _say(hospital: Hospital, visit: Visit, correction: Correction) -> None:
    records = [bytes.fromhex(record_id) for record_id in correction.record_ids]
    hospital.must(visit.key, "rights", "rectify", records, correction.kind, commit_correction(correction))


def test_1_it_needs_nobodys_leave_and_nobody_speaks_for_her(hospital: Hospital, visit: Visit) -> None:
    _say(hospital, visit, _correction(visit, "That is my sister."))
    for key in (hospital.admin, hospital.registrar, hospital.robot.identity, key_of("stranger"), *hospital.custodians):
        refused = hospital.send(key, "rights", "rectify", visit.records[:1], "attribution", bytes(32))
        assert not refused.ok
    assert len(hospital.view("rights", "corrections", visit.owner, 0, 10)) == 1


def test_2_it_outlasts_the_record_it_is_about(hospital: Hospital, visit: Visit) -> None:
    _say(hospital, visit, _correction(visit, "That is my sister."))
    asked = hospital.must(visit.key, "erasure", "request", visit.records, [])
    hospital.receipts_of_all(asked.txid)
    assert len(hospital.view("rights", "corrections", visit.owner, 0, 10)) == 1


def test_3_nothing_that_was_recorded_is_changed(hospital: Hospital, visit: Visit) -> None:
    before = [hospital.value("records", b"record/" + record_id) for record_id in visit.records]
    for number in range(3):
        _say(hospital, visit, _correction(visit, f"Statement {number}."))
    assert [hospital.value("records", b"record/" + record_id) for record_id in visit.records] == before
    entries = {entry.name for entry in hospital.contracts["records"].abi.entries if entry.kind == "export"}
    assert not {name for name in entries if "correct" in name or "rectify" in name or "update" in name}


def test_4_the_chain_does_not_tell_what_she_said(hospital: Hospital, visit: Visit) -> None:
    """The same words twice look unrelated, and a guess cannot be tried without the salt."""
    _say(hospital, visit, _correction(visit, "That is my sister."))
    _say(hospital, visit, _correction(visit, "That is my sister."))
    rows = hospital.view("rights", "corrections", visit.owner, 0, 10)
    assert rows[0]["commitment"] != rows[1]["commitment"]
    guess = commit_correction(_correction(visit, "That is my sister.", bytes(CORRECTION_SALT_BYTES)))
    assert guess not in {row["commitment"] for row in rows}
    assert b"sister" not in repr(rows).encode()


def test_5_whom_she_hands_it_to_can_check_it(hospital: Hospital, visit: Visit) -> None:
    correction = _correction(visit, "That is my sister.")
    _say(hospital, visit, correction)
    (row,) = hospital.view("rights", "corrections", visit.owner, 0, 10)
    assert (row["commitment"], row["time"]) == (commit_correction(correction), hospital.time_ms)
    forged = Correction(correction.kind, "That is me.", correction.salt, correction.visit, correction.record_ids)
    assert commit_correction(forged) != row["commitment"]
