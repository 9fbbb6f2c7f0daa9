"""The consortium that the stories of the system contracts play in."""

from __future__ import annotations

import pytest

from tests.unit.contracts.system.consortium import Consortium


@pytest.fixture
def consortium() -> Consortium:
    """A new chain of three organisations and four producers."""
    return Consortium()
