"""A unit test is in the default tier, whatever its file and its fixtures are called."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.tiers import HERE, find_kinds


def kinds_of(file: str, *fixtures: str) -> list[str]:
    item: Any = SimpleNamespace(path=HERE / file, fixturenames=fixtures)
    return list(find_kinds(item))


@pytest.mark.parametrize("name", ["test_roster.py", "test_rosbag.py", "test_ros1.py", "test_ros2_types.py"])
def test_what_begins_like_ros_listens_to_none(name: str) -> None:
    (file,) = (HERE / "unit").rglob(name)
    assert kinds_of(str(file.relative_to(HERE))) == []


def test_a_client_that_is_called_browser_is_no_chromium() -> None:
    assert kinds_of("unit/pages/test_local_page.py", "browser", "page") == []


def test_what_is_slow_by_its_kind_is_sorted_by_folder_and_fixtures() -> None:
    assert kinds_of("robot_live/test_ros1_feed.py") == ["process", "ros"]
    assert kinds_of("ui/test_wallet_page.py", "browser") == ["process", "browser"]
    assert kinds_of("offchain/test_custodian.py", "mongo_uri") == ["stores"]
    assert kinds_of(str(Path(__file__).relative_to(HERE))) == []
