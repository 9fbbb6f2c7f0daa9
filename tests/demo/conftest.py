"""The database server for the demonstration with MongoDB stores."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.json_answers import answers_of_processes, noted_differences
from tests.offchain import secantus


@pytest.fixture(scope="session")
def mongo_uri() -> Iterator[str]:
    """MONGO_URI if it is set, else a server started for the tests."""
    with secantus.given_or_running() as uri:
        yield uri


@pytest.fixture(scope="module", autouse=True)
def commands_answer_as_documented(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hold what every command answers here with --json, on real nodes, against the reference page of that."""
    file = tmp_path_factory.mktemp("answers") / "answers.jsonl"
    with answers_of_processes(file):
        yield
    assert noted_differences(file) == [], "docs/reference/json-output.md says otherwise"
