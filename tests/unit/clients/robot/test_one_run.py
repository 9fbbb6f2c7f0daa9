"""A robot runs once at a time, and a dead one is in nobody's way."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clients.robot.run.runner import lock_robot
from consensus.errors import BlockRobotError

HOLDER = """
import sys, time
from pathlib import Path
from clients.robot.run.runner import lock_robot
with lock_robot(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""
ROOT = Path(__file__).resolve().parents[4]


def test_a_second_run_of_the_same_robot_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    with lock_robot(tmp_path):
        with pytest.raises(BlockRobotError, match="ROBOT_RUNNING"), lock_robot(tmp_path):
            pass
        (tmp_path / "other").mkdir()
        with lock_robot(tmp_path / "other"):
            pass
    with lock_robot(tmp_path):
        pass


def test_a_robot_that_was_killed_holds_nothing(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(BlockRobotError, match="ROBOT_RUNNING"), lock_robot(tmp_path):
            pass
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        with lock_robot(tmp_path):
            pass


def test_where_there_is_no_robot_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="ROBOT_NOT_FOUND"), lock_robot(tmp_path / "nowhere"):
        pass
