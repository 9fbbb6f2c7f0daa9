"""Real node processes for the tests of this folder."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.cluster.network_under_test import NetworkUnderTest


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes of two organisations."""
    network = NetworkUnderTest(tmp_path / "network", nodes=4)
    try:
        await network.start()
        yield network
    finally:
        await network.close()
