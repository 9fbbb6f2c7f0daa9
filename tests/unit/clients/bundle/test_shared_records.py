"""A bundle of somebody who shared: grants and looks stand in her trail, proved, and name nobody."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

from clients.bundle.checks.bundle_check import verify_bundle
from tests.unit.clients.bundle.conftest import make
from tests.world.sharing import SharedWard


async def test_what_was_shared_is_in_the_bundle_by_its_trail_and_a_stranger_can_check_it(tmp_path: Path) -> None:
    ward = SharedWard(tmp_path)
    doctor = ward.come_in("doctor", "staff")
    visit, (seen, gone) = ward.record_visit()
    shared = await ward.share(doctor)
    receiving = ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    access_id = await receiving.request_access(receipt, [seen])
    await receiving.look(receipt, seen, access_id)
    await ward.erase(visit, [gone])
    (receipt,) = await receiving.inbox()
    await receiving.confirm_deleted(receipt, receipt.to_confirm)
    await make(ward, tmp_path / "mine.zip")

    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert (verdict.is_anchored, verdict.manifest.problems) == (True, [])
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        entries = json.loads(packed.read("data/audit.json"))["entries"]
        accesses = json.loads(packed.read("data/access.json"))["accesses"]
        told = b"".join(packed.read(name) for name in packed.namelist())
    grant_id = shared.grant_id.hex()
    by_kind = {entry["kind"]: entry["data"] for entry in entries}
    assert (by_kind["granted"]["grant_id"], by_kind["granted"]["purpose"]) == (grant_id, "care")
    assert by_kind["grant_noticed"] == {"grant_id": grant_id, "records": [gone.hex()]}
    asked = [entry["data"] for entry in entries if entry["kind"] == "access_requested"]
    assert [data["access_id"] for data in asked if data.get("grant") == grant_id] == [access_id.hex()]
    assert access_id.hex() in {row["access_id"] for row in accesses}
    assert doctor.store.content.handle.hex().encode() not in told
    assert b"Dr Weber" not in told
