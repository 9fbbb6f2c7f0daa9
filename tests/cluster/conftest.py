"""Real node processes for the tests of this folder."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
import pytest_asyncio

from network.bench.custody.custody_clips import ClipRobot
from network.bench.fresh_network import FreshNetwork
from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.cluster.story import Story
from tests.json_answers import answers_of_processes, noted_differences
from tests.offchain import secantus


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes of two organisations."""
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4)) as network:
        yield network


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def shared_network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes for all tests of a module, none of which breaks them."""
    async with running(NetworkUnderTest(tmp_path_factory.mktemp("shared") / "network", nodes=4)) as network:
        yield network


@pytest.fixture
async def story(
    request: pytest.FixtureRequest, tmp_path: Path, record_property: Callable[[str, object], None]
) -> AsyncIterator[Story]:
    """Four running nodes (or as many as the test's parameter says) that can be broken; figures go to the report."""

    def report(name: str, value: object) -> None:
        record_property(name, value)
        sys.stdout.write(f"{name}: {value}\n")

    network = NetworkUnderTest(tmp_path / "network", nodes=getattr(request, "param", 4))
    story = Story(network, report)
    try:
        await network.start()
        yield story
    finally:
        await story.close()
        await network.close()


@pytest.fixture(scope="module")
def mongo_uri() -> Iterator[str]:
    """MONGO_URI if it is set, else a server started for the tests."""
    with secantus.given_or_running() as uri:
        yield uri


@pytest.fixture(params=["sqlite", "mongo"])
async def stage(request: pytest.FixtureRequest) -> AsyncIterator[tuple[FreshNetwork, ClipRobot]]:
    """Four running nodes, two of them custodians, and a robot."""
    store = "sqlite" if request.param == "sqlite" else request.getfixturevalue("mongo_uri")
    async with FreshNetwork(4, store=store) as network:
        (robot,) = await network.enrol_robots(1)
        yield network, ClipRobot(robot.key, network.open_client())


@pytest.fixture(scope="module", autouse=True)
def commands_answer_as_documented(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hold what every command answers here with --json, on real nodes, against the reference page of that."""
    file = tmp_path_factory.mktemp("answers") / "answers.jsonl"
    with answers_of_processes(file):
        yield
    assert noted_differences(file) == [], "docs/reference/json-output.md says otherwise"
