"""GDPR Article 5: the principles, each by the one thing that would break it.

(1)(a) transparency: nothing is done with a record that its owner cannot read; (b) purpose limitation: no purpose, no visit
and no access; (c) minimisation: the chain holds no picture, sensor or person; (d) accuracy: what is wrong can
be said beside it; (e) storage limitation: no record is kept without an end, or erased before it; (f) integrity and
confidentiality: a changed byte is named, and a copy of the store opens nothing; (2) accountability: a custodian answers
for what it did under its own signature.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from msgspec.structs import replace

from consensus.limits import RETENTION_MAX_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.records.clips import check_clip_download
from tests.offchain.conftest import house, make_store  # noqa: F401 - fixtures
from tests.offchain.house import ACCESS_ID, CustodianHarness
from tests.offchain.small_chain import ALICE, access, record_clip, recorded
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, Visit


def test_1_a_each_step_is_in_the_trail_that_its_owner_reads(hospital: Hospital, visit: Visit) -> None:
    asked = hospital.must(visit.key, "access", "request", visit.records, "own-access").txid
    hospital.must(hospital.custodians[0], "access", "released", asked, sorted(visit.records))
    erasure = hospital.must(visit.key, "erasure", "request", visit.records, []).txid
    hospital.receipts_of_all(erasure)
    trail = [entry["kind"] for entry in hospital.view("audit", "events", visit.owner, 0, 50)]
    wanted = ["visit_opened", *["recorded"] * 2, "access_requested", "access_released", "erasure_requested"]
    assert trail[:6] == wanted
    assert len(trail) > 7, "and each receipt"


def test_1_b_without_a_published_purpose_nothing_is_recorded_or_released(hospital: Hospital, anna: Person) -> None:
    _, arguments = hospital.visit_of(anna)
    for code in ("", "advertising", "CARE"):
        receipt = hospital.send(hospital.robot.identity, "records", "open_visit", *arguments[:4], code)
        assert receipt.code == "PURPOSE_UNKNOWN"
        assert hospital.send(anna.identity, "consent", "refuse", anna.handle, [code], []).code == "PURPOSE_UNKNOWN"
    visit = hospital.open_visit(anna, 1)
    hospital.record(visit)
    assert hospital.send(visit.key, "access", "request", visit.records, "advertising").code == "PURPOSE_UNKNOWN"


def test_1_c_the_chain_holds_of_a_record_no_more_than_it_needs(hospital: Hospital, visit: Visit) -> None:
    record = hospital.view("records", "get", visit.records[0])
    assert set(record) == {
        *("owner", "robot", "txid", "height", "status", "awaited", "erased_frames"),
        *("bucket_ms", "expires_at_ms", "commitment_root", "ciphertext_root", "sealed_metadata"),
    }
    assert record["bucket_ms"] % TIME_BUCKET_MS == 0
    assert len(record["sealed_metadata"]) == SEALED_METADATA_BYTES, "sensor, times and counts are sealed, of one size"


def test_1_d_what_is_wrong_is_corrected_beside_it(hospital: Hospital, visit: Visit) -> None:
    commitment = hashlib.sha256(b"it was the afternoon").digest()
    hospital.must(visit.key, "rights", "rectify", visit.records, "metadata", commitment)
    (correction,) = hospital.view("rights", "corrections", visit.owner, 0, 10)
    assert (correction["records"], correction["commitment"]) == (visit.records, commitment)


def test_1_e_no_record_is_without_an_end_and_none_ends_before(hospital: Hospital, visit: Visit) -> None:
    for kept_ms in (0, RETENTION_MAX_MS + DAY_MS):
        arguments = hospital.record_arguments(visit, 7, expires_at_ms=hospital.time_ms + kept_ms)
        assert not hospital.send(visit.robot.identity, "records", "record", *arguments).ok
    call = (hospital.custodians[0], "erasure", "expired", visit.records, bytes(32))
    assert not hospital.send(*call).ok
    hospital.time_ms += 31 * DAY_MS
    hospital.must(*call)


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_1_f_a_changed_byte_is_named_and_a_copy_opens_nothing(house: CustodianHarness, tmp_path: Path) -> None:  # noqa: F811
    clip = record_clip()
    async with house.open() as custodian:
        await house.keep(clip)
        await house.follow(access(ACCESS_ID, clip))
        download = await custodian.download(clip.record_id, ACCESS_ID, ALICE)
        facts = recorded(clip)[2]
        roots = (facts["commitment_root"], facts["ciphertext_root"])
        assert check_clip_download(download, *roots) == []
        frames = list(download.frames)
        frames[1] = replace(frames[1], ciphertext=bytes(len(frames[1].ciphertext)))
        assert check_clip_download(replace(download, frames=frames), *roots) == [1]
    copy = files_of(tmp_path)
    assert not [secret for secret in (*clip.plaintexts, *clip.data_keys) if secret in copy]


def files_of(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def test_2_a_custodian_answers_for_what_it_says_it_did(hospital: Hospital, visit: Visit) -> None:
    erasure = hospital.must(visit.key, "erasure", "request", visit.records, []).txid
    said = [1, "backups of the host", hospital.time_ms + DAY_MS, bytes(32)]
    hospital.must(hospital.custodians[0], "erasure", "receipt", erasure, *said)
    state = hospital.view("erasure", "get", erasure)
    assert list(state["receipts"]) == [hospital.custodians[0].public_key]
    assert state["status"] != "complete", "one does not answer for the other"
    assert hospital.send(hospital.admin, "erasure", "receipt", erasure, *said).code == "NOT_A_CUSTODIAN"
