"""The hospital that the stories of the privacy contracts play in."""

from __future__ import annotations

import pytest

from tests.unit.contracts.privacy.hospital import Hospital


@pytest.fixture
def hospital() -> Hospital:
    """A new chain with one robot registered."""
    return Hospital()
