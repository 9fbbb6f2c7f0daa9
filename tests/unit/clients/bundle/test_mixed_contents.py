"""Mixing: a maker has all keys, and puts together what is real and does not belong together.

Pictures that she fetched before they were erased, proofs of an earlier block, visits that are of somebody else.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from clients.bundle.writing import Contents, write_bundle
from clients.robot.sealing import VisitChain
from clients.wallet.exporting import Exporting, Wanted
from clients.wallet.viewing import Viewing
from consensus.errors import BlockRobotError
from tests.unit.clients.bundle.conftest import NOW_MS
from tests.unit.clients.bundle.ward import Ward


@pytest.fixture
def ward(tmp_path: Path) -> Ward:
    return Ward(tmp_path)


@pytest.fixture
def visit(ward: Ward) -> VisitChain:
    """A visit with one record of two pictures."""
    visit = ward.open_visit()
    ward.record(visit)
    return visit


async def collect(ward: Ward) -> Contents:
    exporting = Exporting(ward.wallet, viewing=Viewing(ward.wallet, follow_max_ms=0), at_once=True)
    return await exporting.collect(await exporting.plan(Wanted()), NOW_MS)


def opened_by(newer: Contents, older: Contents) -> Contents:
    """What the ledger says now, with the pictures and openings of before."""
    proofs = dataclasses.replace(newer.proofs, openings=older.proofs.openings)
    return dataclasses.replace(newer, proofs=proofs, source=older.source)


async def test_a_picture_that_was_kept_and_is_erased_on_the_ledger_is_refused(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    before = await collect(ward)
    record_id = bytes.fromhex(before.proofs.openings.records[0].record_id)
    await ward.erase(visit, [record_id], [0])
    now = await collect(ward)
    assert [frame.status for frame in write_bundle(tmp_path / "now.zip", now).frames] == ["erased", "picture"]
    with pytest.raises(BlockRobotError, match="erased") as caught:
        write_bundle(tmp_path / "mixed.zip", opened_by(now, before))
    assert caught.value.code == "BUNDLE_UNPROVEN"


async def test_a_record_of_a_quarantined_visit_that_was_kept_is_refused(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    """It may show somebody else: nothing of it is opened, and the wallet's own export does not."""
    before = await collect(ward)
    ward.chain.must(await ward.owner_key(visit.owner), "rights", "wrong_person")
    now = await collect(ward)
    assert now.proofs.openings.records == []
    with pytest.raises(BlockRobotError, match="quarantined") as caught:
        write_bundle(tmp_path / "mixed.zip", opened_by(now, before))
    assert caught.value.code == "BUNDLE_UNPROVEN"
