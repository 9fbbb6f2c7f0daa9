"""The units for systemd: it finds nothing wrong with them, and little exposed. tests/hosts/test_systemd.py starts them."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNITS = sorted((ROOT / "deploy" / "systemd").glob("blockrobot-*"))
MANUAL = ROOT / "docs" / "how-to" / "run-in-production.md"
pytestmark = pytest.mark.system_packages


@pytest.fixture
def units(tmp_path: Path) -> list[Path]:
    """With a program that is there."""
    for unit in UNITS:
        program = unit.read_text().replace("/opt/blockrobot/.venv/bin/blockrobot", "/bin/true")
        (tmp_path / unit.name).write_text(program)
    return [tmp_path / unit.name for unit in UNITS]


def analyse(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, check=False)


def test_systemd_finds_nothing_wrong_with_them(units: list[Path]) -> None:
    assert len(units) == 3
    done = analyse("verify", "--man=no", *map(str, units))
    ours = [line for line in done.stderr.splitlines() if "blockrobot" in line]
    assert (done.returncode, ours) == (0, [])


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit.suffix == ".service"], ids=lambda unit: unit.name)
def test_a_service_may_do_little_more_than_it_has_to(unit: Path) -> None:
    done = analyse("security", "--offline=true", "--no-pager", str(unit))
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", done.stdout)
    assert found, done.stdout + done.stderr
    (documented,) = re.findall(r"`systemd-analyze security`: ([0-9.]+) of 10", MANUAL.read_text(encoding="utf-8"))
    assert float(found[1]) <= float(documented)
