"""Every pin has its wheel for every Python and platform that the README names, and what is installed runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.tools import make
from tests.other_pythons import SUPPORTED_MINORS, find_pythons

ROOT = Path(__file__).resolve().parents[2]
UV = ROOT / "build" / "tools" / "bin" / "uv"
PLATFORMS = ("x86_64-manylinux_2_28", "aarch64-manylinux_2_28", "aarch64-apple-darwin")
LOCKS = ("build", "dev")
"""Every other file of pins is a part of these, but for the tools' (tests/architecture/test_pins.py)."""
PYTHONS = find_pythons()

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def uv() -> Path:
    make("build/tools/.tools")
    return UV


def resolve(uv: Path, lock: Path, python: str, platform: str, target: Path) -> subprocess.CompletedProcess[str]:
    """Resolve a file of pins as if on that platform, dependencies too; nothing is installed."""
    return subprocess.run(
        [
            uv, "pip", "install", "--dry-run", "--require-hashes", "--only-binary", ":all:", "--target", target,
            "--python-version", python, "--python-platform", platform, "--requirement", lock,
        ],
        cwd=target, capture_output=True, text=True, check=False, timeout=250,
    )  # fmt: skip


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("minor", SUPPORTED_MINORS)
def test_every_pin_has_a_wheel(uv: Path, minor: int, platform: str, tmp_path: Path) -> None:
    for name in LOCKS:
        done = resolve(uv, ROOT / "requirements" / f"{name}.txt", f"3.{minor}", platform, tmp_path)
        assert done.returncode == 0, f"{name}: {done.stderr[-2000:]}"
        assert "Would install" in done.stderr


def test_a_pin_without_a_wheel_is_found(uv: Path, tmp_path: Path) -> None:
    lock = tmp_path / "lock.txt"
    lock.write_text("coincurve==21.0.0 --hash=sha256:" + "0" * 64 + "\n", encoding="utf-8")
    assert resolve(uv, lock, "3.14", PLATFORMS[0], tmp_path).returncode != 0


@pytest.mark.timeout(3_600)
@pytest.mark.parametrize("version", PYTHONS)
def test_a_fresh_clone_installs_and_shows_a_demonstration(version: str, tmp_path: Path) -> None:
    """For each Python of this machine; what is not committed is not tested. The whole one only where the tests run."""
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    own = {**os.environ, "BLOCKROBOT_HOME": str(tmp_path / "home")}
    commands = [["make", f"PYTHON={PYTHONS[version]}"]]
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        commands += [["make", "demo"]]
        left = clone / "blockrobot-demo" / "summary.json"
    else:
        commands += [[".venv/bin/python", "-m", "tests.experiments.short_run", str(tmp_path), "7"]]
        left = tmp_path / "out" / "summary.json"
    for command in commands:
        done = subprocess.run(command, cwd=clone, env=own, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    assert json.loads(left.read_text(encoding="utf-8"))["ok"]
