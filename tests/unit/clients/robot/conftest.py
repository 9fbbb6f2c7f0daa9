"""The small scene, its recording, and the published run seen by a redactor, each made once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clients.robot.synthetic.scenario import Scenario, parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag

SMALL = """
name = "small"
duration_s = 0.6
frame_rate = 10
width = 160
height = 120
focal_px = 131.0
camera_height_m = 1.2
seed = 7
empty_frames = 3

[reader]
distance_sigma_m = 0.3
antenna_front = 1
antenna_back = 2
front_misread = 0.0

[[people]]
alias = "ann"
height_m = 1.7
girth = 1.0
cadence = 1.0
path = [[0.0, -0.4, 2.5], [0.6, 0.0, 2.2]]
readings_s = [0.1, 0.5]
also_every_s = 0.2
"""


@pytest.fixture
def inline_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is for a thread, done on the loop itself: virtual time would run on while a thread works."""

    async def work(function: Callable[..., Any], *arguments: Any) -> Any:
        return function(*arguments)

    monkeypatch.setattr(asyncio, "to_thread", work)


@pytest.fixture(scope="session")
def small_text() -> str:
    return SMALL


@pytest.fixture(scope="session")
def small_scenario() -> Scenario:
    return parse_scenario(SMALL)


@pytest.fixture(scope="session")
def small_bag(small_scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_bag(small_scenario, {"ann": "E200000000000001"}, tmp_path_factory.mktemp("bags"), workers=1)
