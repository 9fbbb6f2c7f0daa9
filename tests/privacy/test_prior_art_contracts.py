"""The contract defects of the prior art, each as a test that it is not ours (numbers as in the published list).

2: anyone wipes everything. 3: anyone deletes any user. 4: any patient erases another's data. 5: an erasure that meets a
row of somebody else spins until the limit.
"""

from __future__ import annotations

from consensus.primitives.keys import PrivateKey
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit, key_of


def _two_patients() -> tuple[Hospital, Person, Person, Visit, Visit]:
    hospital = Hospital()
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben")
    of_anna, of_ben = hospital.open_visit(anna), hospital.open_visit(ben)
    for visit in (of_anna, of_ben):
        for _ in range(3):
            hospital.record(visit)
    return hospital, anna, ben, of_anna, of_ben


def _everyone(hospital: Hospital, *visits: Visit) -> list[PrivateKey]:
    return [
        key_of("stranger"),
        hospital.registrar,
        hospital.admin,
        hospital.robot.identity,
        *hospital.custodians,
        *(visit.key for visit in visits),
    ]


def test_defect_2_nobody_can_erase_everything() -> None:
    hospital, _, _, of_anna, of_ben = _two_patients()
    everything = of_anna.records + of_ben.records
    for key in _everyone(hospital, of_anna, of_ben):
        assert not hospital.send(key, "erasure", "request", everything, []).ok
        assert not hospital.send(key, "erasure", "request", [], []).ok
        assert not hospital.send(key, "erasure", "eraseall").ok
        assert not hospital.send(key, "erasure", "expired", everything, bytes(32)).ok
        assert not hospital.send(key, "records", "complete_erasure", everything, []).ok
    for record_id in everything:
        assert hospital.view("records", "get", record_id)["status"] == "active"


def test_defect_3_nobody_can_delete_another_user() -> None:
    hospital, anna, ben, of_anna, of_ben = _two_patients()
    strangers = [key for key in _everyone(hospital, of_anna, of_ben) if key not in (hospital.registrar, hospital.admin)]
    for key in [*strangers, ben.identity]:
        assert not hospital.send(key, "identity", "leave", anna.handle).ok
        assert not hospital.send(key, "identity", "revoke", anna.handle).ok
    assert hospital.view("identity", "member", anna.identity.public_key)["status"] == "active"


def test_defect_4_no_patient_erases_anothers_records() -> None:
    hospital, _, ben, of_anna, of_ben = _two_patients()
    for key, code in ((of_ben.key, "NOT_THE_OWNER"), (ben.identity, "NOT_THE_OWNER")):
        for frames in ([], [0]):
            receipt = hospital.send(key, "erasure", "request", of_anna.records[:1], frames)
            assert receipt.code == code
    assert hospital.view("records", "get", of_anna.records[0])["status"] == "active"
    assert hospital.view("records", "get", of_anna.records[0])["erased_frames"] == []


def test_defect_5_a_foreign_row_among_ones_own_ends_the_erasure_at_once() -> None:
    hospital, _, _, of_anna, of_ben = _two_patients()
    mixed = [of_ben.records[0], of_anna.records[0], of_ben.records[1], of_ben.records[2]]
    receipt = hospital.send(of_ben.key, "erasure", "request", mixed, [])
    assert receipt.code == "NOT_THE_OWNER"
    assert receipt.gas_used < 10_000
    assert hospital.view("records", "get", of_ben.records[0])["status"] == "active"
    hospital.must(of_ben.key, "erasure", "request", of_ben.records, [])
