"""Real node processes for the tests of this folder."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.robot_live.tag_readers import TagReaders


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes of two organisations."""
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4)) as network:
        yield network


@pytest.fixture
async def tag_readers() -> AsyncIterator[TagReaders]:
    """Tag readers that end with the test."""
    readers = TagReaders()
    try:
        yield readers
    finally:
        await readers.stop()
