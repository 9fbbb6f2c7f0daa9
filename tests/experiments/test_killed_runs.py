"""A run of experiments that is told to end, or is killed outright, leaves no node and no robot behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from network.cluster import Cluster

ROOT = Path(__file__).resolve().parents[2]
STEP_MAX_S = 180.0


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + STEP_MAX_S
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come about"
        time.sleep(0.1)


def commands_that_name(folder: Path) -> list[str]:
    """The command lines of all processes that name this folder, but for the run itself."""
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = place.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if any(str(folder) in word for word in words) and not any("short_run" in word for word in words):
            found.append(" ".join(words))
    return found


@pytest.mark.timeout(400)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_is_ended_leaves_no_process_behind(tmp_path: Path, number: signal.Signals) -> None:
    """It is ended while the robot records, so that there are nodes and a robot to be left behind."""
    program = [sys.executable, "-m", "tests.experiments.short_run", str(tmp_path), "3"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(program, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for(lambda: any("replay" in line for line in commands_that_name(tmp_path)), "the recording")
        nodes = Cluster(tmp_path / "out" / "experiment-2" / "network")
        assert all(nodes.is_running(name) for name in nodes.names)
        run.send_signal(number)
        assert run.wait(STEP_MAX_S) != 0
        wait_for(lambda: commands_that_name(tmp_path) == [], "the end of every process")
    finally:
        run.kill()
        run.wait()
