"""The hospital that the stories of the privacy contracts play in."""

from __future__ import annotations

import pytest

from tests.unit.contracts.privacy.hospital import Hospital, Visit


@pytest.fixture
def hospital() -> Hospital:
    """A new chain with one robot registered."""
    return Hospital()


@pytest.fixture
def visit(hospital: Hospital) -> Visit:
    """A visit of anna's with three records."""
    visit = hospital.open_visit(hospital.enrol("anna"))
    for _ in range(3):
        hospital.record(visit)
    return visit
