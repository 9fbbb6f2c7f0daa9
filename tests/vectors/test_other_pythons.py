"""Golden vectors, random programs and hostile ones, in processes of their own: other hash seeds, other Pythons.

Each gives the same outcomes and charges as this one. A Python that this machine does not have is not tested.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from contracts import vectors
from tests.other_pythons import find_pythons

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CACHE = ROOT / ".pytest_cache" / "pythons"
LOCK = ROOT / "requirements" / "runtime.txt"
LIBRARIES = ("msgspec", "btclib-secp256k1", "cffi", "pycparser")
"""What the contract machine imports; the rest of the lock is left out."""
SEEDS = ("0", "1", "4242")
PROGRAMS = 60
THIS = sys.version_info[:2]


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command], check=False, capture_output=True, text=True, timeout=250, cwd=ROOT,
        env={"PATH": os.environ["PATH"], "PYTHONDONTWRITEBYTECODE": "1", **environment},
    )  # fmt: skip


def read_pins() -> str:
    """Return the lock's lines of the contract machine's libraries, hashes included."""
    pins = LOCK.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    wanted = [pin for pin in pins if pin.partition("==")[0] in LIBRARIES]
    assert len(wanted) == len(LIBRARIES)
    return "\n".join(["--only-binary :all:", *wanted, ""])


def prepare(version: str, interpreter: Path) -> Path:
    """Return a Python of this version that has the pinned libraries, in an environment that is kept."""
    folder, pins = CACHE / version, read_pins()
    python, kept = folder / "bin" / "python", folder / "pins.txt"
    if (
        kept.exists()
        and kept.read_text(encoding="utf-8") == pins
        and run(python, "-c", "import msgspec").returncode == 0
    ):
        return python
    made = run(interpreter, "-m", "venv", "--clear", folder)
    assert made.returncode == 0, made.stderr[-2000:]
    asked = folder / "asked.txt"
    asked.write_text(pins, encoding="utf-8")
    settings = {key: value for key, value in os.environ.items() if key.startswith("PIP_")}
    pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes")
    done = run(*pip, "--requirement", asked, **settings, HOME=str(Path.home()))
    assert done.returncode == 0, done.stderr[-2000:]
    asked.rename(kept)
    return python


def play(python: Path | str, seed: str, *more: str) -> dict[str, Any]:
    done = run(python, HERE / "playing.py", HERE / "contracts", str(PROGRAMS), *more, PYTHONHASHSEED=seed)
    assert done.returncode == 0, done.stderr[-3000:]
    return dict(json.loads(done.stdout))


@cache
def here() -> dict[str, Any]:
    return play(sys.executable, "0")


def expect_the_same(found: dict[str, Any], version: tuple[int, int]) -> None:
    assert found["differences"] == []
    assert found["count"] == sum(
        vectors.count(document) for document in vectors.read_vectors(HERE / "contracts").values()
    )
    assert found["programs"] == here()["programs"]
    assert (found["misfits"], found["corpus"], found["fuzzed"]) == ([], here()["corpus"], here()["fuzzed"])
    assert tuple(found["version"][:2]) == version


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_every_hash_seed_gives_the_same(seed):
    expect_the_same(play(sys.executable, seed), THIS)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_every_other_python_of_this_machine_gives_the_same():
    told = {THIS: here()}
    others = {name: place for name, place in find_pythons().items() if name != f"{THIS[0]}.{THIS[1]}"}
    for name, interpreter in others.items():
        version = (3, int(name.partition(".")[2]))
        python = prepare(name, interpreter)
        for seed in SEEDS:
            told[version] = play(python, seed)
            expect_the_same(told[version], version)
    assert len(told) == 1 + len(others)
    assert len({(found["programs"], found["corpus"], found["fuzzed"]) for found in told.values()}) == 1


def test_pythons_that_do_not_answer_are_not_taken_for_pythons(tmp_path, monkeypatch):
    broken = tmp_path / "python3.14"
    broken.write_text("#!/bin/sh\nexit 127\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert shutil.which("python3.14") == str(broken)
    assert find_pythons().get("3.14") != broken
