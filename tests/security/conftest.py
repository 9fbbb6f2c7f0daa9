"""One network of four real nodes for a whole module: bad input must not wear it down."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.security.intruder import Intruder


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes of two organisations."""
    async with running(NetworkUnderTest(tmp_path_factory.mktemp("security") / "network", nodes=4)) as network:
        yield network


@pytest_asyncio.fixture(loop_scope="module")
async def intruder(network: NetworkUnderTest) -> AsyncIterator[Intruder]:
    """Somebody with an HTTP client and bad intentions, at the network's first node."""
    async with Intruder(network) as intruder:
        yield intruder
