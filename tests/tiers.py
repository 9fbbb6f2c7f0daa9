"""Sorts the tests into tiers. A plugin of pytest.

The kind of a test follows from its folder and its fixtures. Whatever is slow by its kind (processes, a browser, a
database or object server, ROS, typed documents) is in the long tier, unless it is marked `smoke`: `make test` runs the
smoke tests and everything else, `make test-long` runs all.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

HERE = Path(__file__).parent
PROCESS_FOLDERS = ("benchmarks", "cluster", "demo", "experiments", "hosts", "install", "robot_live", "security", "ui")
"""Their tests start programs: nodes, robots, wallets, brokers."""
SLOW_KINDS = ("process", "browser", "stores", "ros", "docs")
"""Kinds that only the long tier runs whole."""
SLOWEST_FIRST = (
    "demo",
    "cluster",
    "offchain",
    "ui",
    "security",
    "benchmarks",
    "robot_live",
    "experiments",
    "sim",
    "hostile",
    "worker",
)
"""Two processes share the tests by files: one that takes a minute must not be the last."""
EXAMPLES_COUNT = {"default": 25, "long": 200}
"""Hypothesis: how many examples of a property, in each tier."""

hypothesis.settings.register_profile("default", max_examples=EXAMPLES_COUNT["default"], derandomize=True, deadline=None)
hypothesis.settings.register_profile("long", max_examples=EXAMPLES_COUNT["long"], deadline=None, print_blob=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


def find_kinds(item: pytest.Item) -> Iterator[str]:
    """Yield the kinds of a test by its place and its fixtures."""
    folder = item.path.relative_to(HERE).parts[0]
    fixtures = getattr(item, "fixturenames", ())
    store = item.callspec.params.get("make_store") if hasattr(item, "callspec") else None
    if folder in PROCESS_FOLDERS:
        yield "process"
    if folder == "hosts":
        yield "hosts"
    if folder == "ui" and "browser" in fixtures:
        yield "browser"
    if {"mongo_uri", "driver_sockets", "s3_server"} & set(fixtures) or store not in {None, "sqlite"}:
        yield "stores"
    if folder == "robot_live" and item.path.name.startswith("test_ros"):
        yield "ros"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test with its kinds and its tier; put the folders whose tests take longest first."""
    own = [item for item in items if item.path.is_relative_to(HERE)]
    for item in own:
        for kind in find_kinds(item):
            item.add_marker(kind)
        if any(item.get_closest_marker(kind) for kind in SLOW_KINDS) and not item.get_closest_marker("smoke"):
            item.add_marker("long")
    order = {name: number for number, name in enumerate(SLOWEST_FIRST)}
    if len(own) == len(items):
        items.sort(key=lambda item: order.get(item.path.relative_to(HERE).parts[0], len(order)))
