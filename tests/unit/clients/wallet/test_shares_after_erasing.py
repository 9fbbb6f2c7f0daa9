"""What the two sides of a share are told once something of it was erased."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.unit.clients.wallet.test_sharing_commands import People


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> People:
    return People(tmp_path, monkeypatch)


def test_after_one_picture_was_erased_both_sides_are_told_that_the_share_is_over_and_nothing_contradicts_it(
    people: People, tmp_path: Path
) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (record_id,) = ward.record_visit(1)
    people.share(record_id, "--yes")
    name = people.told(ann, "shares")["shares"][0]["grant_id"][:12]
    people.run(doctor, "look", name, "--out", tmp_path / "shared")
    asyncio.run(ward.erase(visit, [record_id], [1]))
    said = people.run(ann, "shares").output
    assert "care: nothing of it is shared any more" in said
    assert "of 1 record single pictures were erased since: it is shared no more" in said
    assert "1 record could be fetched then" in said
    for part in ("until", "may be fetched", "To end it"):
        assert part not in said
    height = ward.chain.height
    for more in ((), (record_id.hex()[:8],)):
        refused = people.run(doctor, "look", name, *more, "--out", tmp_path / "again")
        assert (refused.exit_code, "GRANT_ENDED" in refused.output) == (3, True), refused.output
        assert "Single pictures of it were erased since it was shared, which ends the share." in refused.output
        assert "Everything" not in refused.output
        assert "erasures" not in refused.output, "the receipts are the owner's"
    assert ward.chain.height == height, "no look stands on the ledger that could see nothing"


def test_after_the_whole_record_was_erased_nobody_speaks_of_single_pictures(people: People) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (first, second) = ward.record_visit()
    asyncio.run(ward.share(doctor))
    asyncio.run(ward.erase(visit, [first], [1]))
    asyncio.run(ward.erase(visit, [first]))
    (row,) = people.told(ann, "shares")["shares"]
    assert (row["cut"], row["erased"]) == ([], [first.hex()])
    said = people.run(ann, "shares").output
    assert "1 record was erased since: it is shared no more" in said
    assert "single pictures" not in said
    assert "until" in said, "the other record is still shared"
    asyncio.run(ward.erase(visit, [second]))
    refused = people.run(doctor, "look", row["grant_id"][:12])
    assert (refused.exit_code, "GRANT_ENDED" in refused.output) == (3, True), refused.output
    assert "All of it was erased since it was shared." in refused.output
