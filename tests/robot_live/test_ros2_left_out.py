"""Where tests of ROS 2 cannot run they fail first of all and say what to type."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_RIGHTS = """
import ctypes, os, sys
PR_CAPBSET_DROP, CAP_SYS_ADMIN = 24, 21
ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_ADMIN)
os.execv(sys.executable, [sys.executable, "-m", "tests.robot_live.ros2_wheels"])
"""


@pytest.mark.smoke
def test_without_the_right_to_a_network_of_its_own_the_way_out_is_named() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_RIGHTS], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "need a network and a /dev/shm of their own" in done.stderr
    assert "unshare --map-root-user make test" in done.stderr
    assert "make test ROS2=none" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.ros2
def test_without_an_index_of_packages_the_way_out_is_named(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_DATA_HOME": str(tmp_path), "PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull}
    done = subprocess.run(
        [sys.executable, "-m", "tests.robot_live.ros2_wheels"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "cannot be installed" in done.stderr
    assert "make test PYTHON=python3.11" in done.stderr
    assert "make test ROS2=none" in done.stderr
