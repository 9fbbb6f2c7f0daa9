"""The pytest plugin: fixture `chain`, and a gas and coverage report."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from contracts.kit.chain import Chain
from contracts.kit.report import Report
from contracts.kit.sources import is_contract_file

_REPORT = pytest.StashKey[Report]()
_FILE = pytest.StashKey[Path]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("blockrobot")
    group.addoption("--contract-report", metavar="FILE", help="write gas and coverage of contracts to FILE, as JSON")


def pytest_configure(config: pytest.Config) -> None:
    place = config.getoption("--contract-report", default=None)
    if place:
        config.stash[_REPORT] = Report()
        config.stash[_FILE] = Path(str(place))


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    if collection_path.suffix == ".py" and collection_path.is_file() and is_contract_file(collection_path):
        return True
    return None


@pytest.fixture
def chain(request: pytest.FixtureRequest) -> Iterator[Chain]:
    """A fresh chain that finds sources beside the test file."""
    made = Chain(folder=request.path.parent)
    yield made
    if _REPORT in request.config.stash:
        request.config.stash[_REPORT].add(made)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if _REPORT in session.config.stash:
        document = session.config.stash[_REPORT].document()
        session.config.stash[_FILE].write_text(json.dumps(document), encoding="utf-8")
