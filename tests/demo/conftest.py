"""The database server for the demonstration with MongoDB stores."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.offchain import secantus


@pytest.fixture(scope="session")
def mongo_uri() -> Iterator[str]:
    """MONGO_URI if it is set, else a server started for the tests."""
    with secantus.given_or_running() as uri:
        yield uri
