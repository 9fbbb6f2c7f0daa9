"""What the articles share: a hospital with a person who was recorded, and the bundle that her wallet makes."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from consensus.primitives.keys import PrivateKey
from network.notices.notice_publishing import demo_notice
from tests.unit.clients.bundle.conftest import make
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit
from tests.world.notices import NoticeWard
from tests.world.ward import Ward


@pytest.fixture
def hospital() -> Hospital:
    return Hospital()


@pytest.fixture
def anna(hospital: Hospital) -> Person:
    return hospital.enrol("anna")


@pytest.fixture
def visit(hospital: Hospital, anna: Person) -> Visit:
    """A visit of hers with two records."""
    visit = hospital.open_visit(anna)
    for _ in range(2):
        hospital.record(visit)
    return visit


@pytest.fixture
def officer(hospital: Hospital) -> PrivateKey:
    return hospital.enrol("officer", "officer").identity


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


@pytest.fixture
def published(tmp_path: Path) -> NoticeWard:
    """A ward with a notice in force."""
    ward = NoticeWard(tmp_path)
    ward.publish(demo_notice())
    return ward
