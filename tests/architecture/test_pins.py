"""What is installed is what was pinned: versions and hashes in requirements/, and nothing by its name alone."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "requirements"
LOCKS = sorted(FOLDER.glob("*.txt"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PIN = re.compile(r"(?P<name>[a-z0-9-]+)==(?P<version>[^ ;]+)(?: ;[^-]+?)?(?P<hashes>(?: --hash=sha256:[0-9a-f]{64})+)")
BY_NAME = re.compile(
    r"(?:pip|pipx|uv) (?:tool )?install [^\n]*(?<![/\w])blockrobot(?![-/\w])|blockrobot\[", re.IGNORECASE
)
SAID_IN = {".py", ".md", ".toml", ".html", ".js", ".yaml", ".yml", ".cff"}


def pins_of(lock: Path) -> dict[str, str]:
    """Return the versions of a lock file by name. Raises AssertionError for a line that is no pin with hashes."""
    text = lock.read_text(encoding="utf-8")
    joined = re.sub(r"\s*\\\n\s*", " ", text).splitlines()
    lines = [line for line in joined if line and not line.startswith("#")]
    assert lines[0] == "--only-binary :all:", lock.name
    found: dict[str, str] = {}
    for line in lines[1:]:
        pin = PIN.fullmatch(line)
        assert pin, f"{lock.name}: {line[:80]}"
        assert pin["name"] not in found, f"{lock.name}: {pin['name']} twice: one resolution for every Python"
        found[pin["name"]] = pin["version"]
    return found


def named(requirement: str) -> str:
    return re.split(r"[ <>=;\[]", requirement)[0].lower().replace("_", "-").replace(".", "-")


def test_every_pin_has_a_version_and_hashes_in_one_resolution() -> None:
    assert {lock.stem for lock in LOCKS} >= {"build", "runtime", "dev", "tools"}
    for lock in LOCKS:
        assert pins_of(lock)
    everything = pins_of(FOLDER / "dev.txt")
    for lock in LOCKS:
        if lock.stem not in {"build", "deploy", "fuzz", "tools"}:
            assert pins_of(lock).items() <= everything.items(), lock.name
    built_by = [f"{name}=={version}" for name, version in pins_of(FOLDER / "build.txt").items()]
    assert PROJECT["build-system"]["requires"] == built_by
    project = PROJECT["project"]
    assert {named(wanted) for wanted in project["dependencies"]} <= set(pins_of(FOLDER / "runtime.txt"))
    for extra, wanted in project["optional-dependencies"].items():
        assert {named(requirement) for requirement in wanted} <= set(pins_of(FOLDER / f"{extra}.txt")), extra


def test_a_line_without_hashes_is_found(tmp_path: Path) -> None:
    lock = tmp_path / "x.txt"
    for line in ("a==1.0", "a>=1 --hash=sha256:" + "0" * 64, "--editable ."):
        lock.write_text(f"--only-binary :all:\n{line}\n", encoding="utf-8")
        with pytest.raises(AssertionError):
            pins_of(lock)


def test_nobody_is_told_to_install_by_name() -> None:
    """The name may be somebody else's at the index."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    names = [name for name in listed.stdout.split("\0") if Path(name).suffix in SAID_IN or name.endswith("Dockerfile")]
    told = [
        f"{name}: {found.group()}"
        for name in names
        if name not in {"CHANGELOG.md", "tests/architecture/test_pins.py"} and (ROOT / name).exists()
        for found in [BY_NAME.search((ROOT / name).read_text(encoding="utf-8"))]
        if found
    ]
    assert told == []
    assert BY_NAME.search("`pip install 'blockrobot[x]'`")
    assert BY_NAME.search("pip install blockrobot")
    assert not BY_NAME.search("pip install --no-deps --no-build-isolation /opt/blockrobot")
