"""Tests that a machine cannot run are left out only by one's word to `make test`, and counted in the last lines."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class LeftOut:
    """A kind of tests: its marker, the Makefile's word for it, and a file of them."""

    marker: str
    variable: str
    installed_by: str
    installs_always: bool
    one_file: str
    reason: str


KINDS = [
    LeftOut(
        marker="system_packages",
        variable="SYSTEM_PACKAGES",
        installed_by="tests/system_packages.py",
        installs_always=True,  # told "none", it says what is left out
        one_file="tests/ui/test_what_pages_are_judged_by.py",
        reason="they need Debian's chromium",
    ),
    LeftOut(
        marker="ros2",
        variable="ROS2",
        installed_by="tests.robot_live.ros2_wheels",
        installs_always=False,
        one_file="tests/robot_live/test_ros2_feed.py",
        reason="they need wheels of ROS 2",
    ),
]
by_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.marker)


@by_kind
@pytest.mark.parametrize("value", ["none", "install"])
def test_the_makefile_deselects_by_the_marker_only_when_told_to(kind: LeftOut, value: str) -> None:
    make = shutil.which("make")
    assert make
    told = subprocess.run(
        [make, "--dry-run", "test", f"{kind.variable}={value}"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert (f"not {kind.marker}" in told) == (value == "none")
    assert (kind.installed_by in told) == (value == "install" or kind.installs_always)


@by_kind
def test_who_is_left_out_is_said_in_the_last_lines(kind: LeftOut) -> None:
    told = subprocess.run(
        [sys.executable, "-m", "pytest", "-m", f"not {kind.marker}", "--collect-only", "-q", kind.one_file],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    last = told.strip().splitlines()[-6:]
    assert any(f"tests were NOT run: {kind.reason}" in line for line in last), told
    assert any(kind.one_file in line for line in last)
