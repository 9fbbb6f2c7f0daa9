"""What the articles on taking data along share: somebody who was recorded, and the bundle that her wallet made."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from tests.unit.clients.bundle.conftest import make
from tests.unit.clients.bundle.ward import Ward


@pytest.fixture
async def ward(tmp_path: Path) -> Ward:
    """Somebody who was recorded twice, looked, had one record erased; and a stranger in the same ward."""
    ward = Ward(tmp_path)
    visit = ward.open_visit()
    ward.record(visit)
    erased = ward.record(visit)
    ward.close_visit(visit)
    await ward.erase(visit, [erased])
    stranger = ward.chain.enrol("stranger")
    ward.chain.record(ward.chain.open_visit(stranger))
    await make(ward, tmp_path / "mine.zip")
    return ward


@pytest.fixture
def bundle(ward: Ward, tmp_path: Path) -> zipfile.ZipFile:
    return zipfile.ZipFile(tmp_path / "mine.zip")
