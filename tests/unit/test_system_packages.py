"""What `make test` does about Debian packages that are missing: installs them, or says what to type; never a silence."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import system_packages
from tests.system_packages import PACKAGES

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tests" / "system_packages.py"
APT = """#!/bin/sh
echo "$@" >> "{log}"
case "$*" in *install*) for program in chromium dot; do cp "$0" "{folder}/$program"; done;; esac
"""


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is the whole PATH, with what the script itself calls in it."""
    folder = tmp_path / "programs"
    folder.mkdir()
    for name in ("env", "sh", "cp", "rm"):
        (folder / name).symlink_to(shutil.which(name, path=f"{os.defpath}:/usr/bin:/bin") or "")
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(system_packages, "PACKAGES", system_packages.PACKAGES[:2])  # those that are programs
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    return folder


def put(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text, encoding="utf-8")
    (folder / name).chmod(0o755)


def test_what_is_missing_is_installed_and_said_in_one_line(
    programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log"
    put(programs, "apt-get", APT.format(log=log, folder=programs))
    assert system_packages.main() == 0
    told = capsys.readouterr()
    assert told.out.splitlines() == [
        "Installing for the tests, by apt-get: chromium (opens our pages), graphviz (draws the process map)."
    ]
    assert told.err == ""
    update, install = log.read_text(encoding="utf-8").splitlines()
    assert update == "-qq update"
    assert install.split()[-2:] == ["chromium", "graphviz"]
    assert system_packages.main() == 0
    assert capsys.readouterr().out == "", "nothing is missing any more: no word, and no apt-get"
    assert len(log.read_text(encoding="utf-8").splitlines()) == 2


@pytest.mark.parametrize("is_running", [True, False])
def test_what_an_installation_starts_is_switched_off_again(
    programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_running: bool
) -> None:
    (prometheus,) = [package for package in PACKAGES if package.name == "prometheus"]
    monkeypatch.setattr(system_packages, "PACKAGES", (prometheus,))
    monkeypatch.setattr(system_packages, "SYSTEMD_RUNS", tmp_path if is_running else tmp_path / "nowhere")
    put(programs, "apt-get", f'#!/bin/sh\ncase "$*" in *install*) cp "$0" "{programs}/promtool";; esac\n')
    put(programs, "systemctl", f'#!/bin/sh\necho "$@" > "{tmp_path}/log"\n')
    assert system_packages.main(tier="long") == 0
    told = (tmp_path / "log").read_text() if is_running else ""
    assert told == ("--quiet disable --now prometheus.service\n" if is_running else "")
    assert (tmp_path / "log").exists() == is_running


def test_who_is_not_root_goes_by_sudo_that_asks_for_no_password(
    programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    put(programs, "apt-get", APT.format(log=tmp_path / "log", folder=programs))
    put(programs, "sudo", '#!/bin/sh\n[ "$1" = -n ] && shift && [ "$1" = true ] || exec "$@"\n')
    assert system_packages.main() == 0


@pytest.mark.parametrize(
    ("made", "is_root", "reason"),
    [
        ({}, True, "this system has no apt-get"),
        ({"apt-get": "#!/bin/sh\n"}, False, "you are not root, and there is no sudo"),
        ({"apt-get": "#!/bin/sh\n", "sudo": "#!/bin/sh\nexit 1\n"}, False, "sudo would ask for a password"),
        ({"apt-get": "#!/bin/sh\necho 'E: no route' >&2\nexit 100\n"}, True, "`apt-get update` failed: E: no route"),
        ({"apt-get": "#!/bin/sh\n"}, True, "chromium, graphviz is not here all the same"),
    ],
)
def test_where_nothing_can_be_installed_the_refusal_says_what_to_type(
    programs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    made: dict[str, str],
    is_root: bool,
    reason: str,
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0 if is_root else 1000)
    for name, text in made.items():
        put(programs, name, text)
    assert system_packages.main() == 1
    told = capsys.readouterr().err
    assert reason in told
    assert "sudo apt-get update && sudo apt-get install --no-install-recommends chromium graphviz" in told
    assert "make test SYSTEM_PACKAGES=none" in told


def test_what_is_left_out_is_said_before_the_first_test_too(tmp_path: Path) -> None:
    told = subprocess.run([sys.executable, SCRIPT, "none"], env={}, capture_output=True, text=True, check=True).stdout
    (line,) = told.splitlines()
    assert all(package.name in line for package in system_packages.PACKAGES)
    assert "left out" in line


def test_what_the_long_tier_alone_needs_comes_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    rare = system_packages.Package("umoci", "makes an image", programs=("not-here",), is_for_long_tests=True)
    monkeypatch.setattr(system_packages, "PACKAGES", (rare,))
    assert system_packages.find_missing() == []
    assert system_packages.find_missing("long") == [rare]
    make = shutil.which("make")
    assert make
    told = {
        tier: subprocess.run([make, "--dry-run", tier], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for tier in ("test", "test-long")
    }
    assert {tier: "system_packages.py install long" in text for tier, text in told.items()} == {
        "test": False,
        "test-long": True,
    }
