"""GDPR Article 17: what was recorded of a person is erased when she asks, and when its time is over.

(1) she alone asks, for all of it or a part, and every custodian confirms; (2) keys go first and bytes with them: no file
of the custodian has either afterwards; (3) the chain's own state of the record loses what pointed at it; (4) a custodian
that was away erases before it serves; (5) its time over, it goes unasked; (6) what she needs for a claim stays, because
she said so (paragraph 3(e)): `unit/contracts/privacy/test_rights.py`; (7) who has lost her key for good is not kept from
it: two officers do it, by robot and minutes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.offchain.conftest import house, make_store  # noqa: F401 - fixtures
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, refused
from tests.offchain.small_chain import ALICE, EXPIRES_MS, access, erasure, record_clip
from tests.unit.contracts.privacy.hospital import Hospital, Visit


def files_of(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def test_1_and_3_every_custodian_confirms_and_the_chain_forgets_what_pointed_at_it(
    hospital: Hospital, visit: Visit
) -> None:
    gone, kept = visit.records
    erasure_id = hospital.must(visit.key, "erasure", "request", [gone], []).txid
    assert hospital.view("records", "get", gone)["status"] == "erasing"
    hospital.receipts_of_all(erasure_id)
    record = hospital.view("records", "get", gone)
    assert record["status"] == "erased"
    assert (record["commitment_root"], record["ciphertext_root"], record["sealed_metadata"]) == (b"", b"", b"")
    assert hospital.view("records", "get", kept)["status"] == "active"
    assert hospital.send(visit.key, "access", "request", [gone], "own-access").code == "RECORD_ERASED"


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_2_neither_key_nor_picture_is_in_any_file_afterwards(house: CustodianHarness, tmp_path: Path) -> None:  # noqa: F811
    gone, kept = record_clip(), record_clip()
    async with house.open():
        for clip in (gone, kept):
            await house.keep(clip)
        rows = await house.store.frames(gone.record_id)
        needles = [
            part for row in rows for part in (row.ciphertext[:64], row.wrapped_key[:48], house.keys.read(row.slot))
        ]
        assert all(needle in files_of(tmp_path) for needle in needles)
        await house.follow(erasure(ERASURE_ID, gone))
        assert not [needle for needle in needles if needle in files_of(tmp_path)]
        assert kept.upload.ciphertexts[0][:64] in files_of(tmp_path)
        [(call, arguments)] = await house.ready_outbox()
        assert (call, arguments[0]) == ("erasure.receipt", ERASURE_ID)


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_4_a_custodian_that_was_away_erases_before_it_serves(house: CustodianHarness) -> None:  # noqa: F811
    clip = record_clip()
    async with house.open():
        await house.keep(clip)
        await house.follow(access(ACCESS_ID, clip))
    missed = house.chain.block(erasure(ERASURE_ID, clip))
    async with house.open() as custodian:
        await custodian.on_finalized_block(missed)
        await refused("CLIP_ERASED", custodian.download(clip.record_id, ACCESS_ID, ALICE))


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_5_its_time_over_it_goes_unasked(house: CustodianHarness) -> None:  # noqa: F811
    clip = record_clip()
    async with house.open() as custodian:
        await house.keep(clip)
        await house.follow(at_ms=EXPIRES_MS)
        await refused("CLIP_ERASED", custodian.export(clip.record_id))
        [(call, arguments)] = await house.ready_outbox()
        assert (call, arguments[0]) == ("erasure.expired", [clip.record_id])


def erase_together(hospital: Hospital, visit: Visit, visits: list[Visit]) -> list[str]:
    """Two officers erase what the robot of a visit opened in its five minutes; return how the chain answers for each."""
    first, second = (hospital.enrol(name, "officer").identity for name in ("eva", "max"))
    span = [visit.robot.identity.public_key, visit.bucket_ms, visit.bucket_ms + 300_000]
    hospital.time_ms = span[2]
    proposal_id = hospital.must(first, "officers", "propose", *span, "key-lost", len(visits)).txid
    early = [hospital.send(first, "officers", "erase", proposal_id, one.owner, one.records) for one in visits]
    assert {receipt.code for receipt in early} == {"NOT_APPROVED"}, "one alone does not"
    hospital.must(second, "officers", "approve", proposal_id)
    ordered = [hospital.send(second, "officers", "erase", proposal_id, one.owner, one.records) for one in visits]
    for receipt in ordered:
        if receipt.ok:
            hospital.receipts_of_all(receipt.txid)
    return [receipt.code for receipt in ordered]


def test_7_a_lost_key_does_not_keep_her_from_it(hospital: Hospital, visit: Visit) -> None:
    assert erase_together(hospital, visit, [visit]) == ["OK"]
    for record_id in visit.records:
        record = hospital.view("records", "get", record_id)
        assert (record["status"], record["sealed_metadata"]) == ("erased", b"")


def test_7_what_somebody_needs_stays_and_everybody_hit_is_told(hospital: Hospital, visit: Visit) -> None:
    needed, bystander = hospital.open_visit(hospital.enrol("ben")), hospital.open_visit(hospital.enrol("cleo"))
    for one in (needed, bystander):
        hospital.record(one)
    hospital.must(needed.key, "rights", "restrict", [], "legal-claim")
    answers = erase_together(hospital, visit, [visit, needed, bystander])
    assert answers == ["OK", "RECORD_RESTRICTED", "OK"]
    assert hospital.view("records", "get", needed.records[0])["status"] == "active"
    for one, times in ((visit, 1), (needed, 0), (bystander, 1)):
        told = [event for event in hospital.view("audit", "events", one.owner, 0, 50) if "reason" in event["data"]]
        assert [(event["kind"], event["data"]["reason"]) for event in told] == [
            ("erased_by_officers", "key-lost")
        ] * times
