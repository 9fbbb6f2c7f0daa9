"""Exporting: what goes along, what is named as missing, and that a stranger can check it without anything else."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from clients.bundle.checking import Verdict, verify_bundle
from clients.bundle.writing import write_bundle
from clients.wallet.exporting import Exporting, Wanted
from clients.wallet.viewing import Viewing
from tests.unit.clients.bundle.ward import Ward

NOW_MS = 1_900_000_000_000


@pytest.fixture
def ward(tmp_path: Path) -> Ward:
    return Ward(tmp_path)


async def export(ward: Ward, path: Path, wanted: Wanted | None = None, *, replace: bool = False) -> Verdict:
    exporting = Exporting(ward.wallet, viewing=Viewing(ward.wallet, follow_max_ms=0))
    plan = await exporting.plan(wanted or Wanted())
    return write_bundle(path, await exporting.collect(plan, NOW_MS), replace=replace)


async def test_everything_goes_along_and_a_stranger_can_check_it(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    ids = [ward.record(visit) for _ in range(3)]
    ward.close_visit(visit)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert verify_bundle(tmp_path / "mine.zip", ward.genesis).is_anchored
    assert [record.record_id for record in verdict.records] == [record_id.hex() for record_id in ids]
    assert all(record.metadata_proved for record in verdict.records)
    assert [frame.status for frame in verdict.frames] == ["picture"] * 6
    assert verdict.manifest.problems == []
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        assert packed.testzip() is None
        told = json.loads(packed.read("data/visits.json"))
        pictures = [name for name in packed.namelist() if name.startswith("pictures/")]
    assert told["visits"][0]["missing"] == 0
    assert pictures == sorted(pictures)
    assert len(pictures) == 6
