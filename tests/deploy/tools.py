"""The programs that judge deploy/: kubectl, ansible-playbook and validators, pinned, in build/deploy-tools."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
TOOLS = ROOT / "build" / "deploy-tools"


def make(target: str, python: str = sys.executable) -> None:
    """What the Makefile makes; two processes of tests wait for each other."""
    (ROOT / "build").mkdir(exist_ok=True)
    with (ROOT / "build" / "tests.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = ["make", target, f"PYTHON={python}"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def judge(program: str, *arguments: str | Path) -> str:
    """What a program answers that finds nothing wrong."""
    make("build/deploy-tools/.tools")
    done = subprocess.run([TOOLS / "bin" / program, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
