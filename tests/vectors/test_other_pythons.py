"""Golden vectors, random programs and hostile ones, in processes of their own: other hash seeds, other Pythons.

Each gives the same outcomes and charges as this one. Where msgspec and coincurve cannot be installed for a Python, that
is said out loud and stand-ins in plain Python take their place: the vectors were written with the real ones.
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

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CACHE = ROOT / ".pytest_cache" / "pythons"
LIBRARIES = ("msgspec", "coincurve")
SEEDS = ("0", "1", "4242")
PROGRAMS = 60
THIS = sys.version_info[:2]


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command], check=False, capture_output=True, text=True, timeout=250, cwd=ROOT,
        env={"PATH": os.environ["PATH"], "PYTHONDONTWRITEBYTECODE": "1", **environment},
    )  # fmt: skip


def find_pythons() -> dict[str, Path]:
    """Return every other Python from 3.11 on that is on the path and answers, by version."""
    found: dict[str, Path] = {}
    for minor in range(11, 30):
        name = f"python3.{minor}"
        place = shutil.which(name)
        if (3, minor) == THIS or place is None:
            continue
        told = run(place, "-c", "import sys; print('%d.%d' % sys.version_info[:2])")
        if told.returncode == 0 and told.stdout.strip() == f"3.{minor}":
            found[name] = Path(place)
    return found


PYTHONS = find_pythons()


@cache
def prepare(name: str) -> tuple[Path, str]:
    """Return a Python that has the libraries, or the plain one and why it has not."""
    folder = CACHE / name
    python = folder / "bin" / "python"
    if run(python, "-c", "import msgspec, coincurve").returncode == 0 if python.exists() else False:
        return python, ""
    made = run(PYTHONS[name], "-m", "venv", "--clear", folder)
    if made.returncode:
        return PYTHONS[name], f"no virtual environment can be made: {made.stderr[-200:]}"
    settings = {key: value for key, value in os.environ.items() if key.startswith("PIP_")}
    pip = (
        python,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--retries",
        "0",
        "--timeout",
        "20",
    )
    done = run(*pip, "--constraint", ROOT / "constraints.txt", *LIBRARIES, **settings, HOME=str(Path.home()))
    if done.returncode:
        return PYTHONS[name], (done.stderr.strip().splitlines() or ["pip failed"])[-1]
    return python, ""


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


@pytest.mark.parametrize("seed", SEEDS)
def test_every_hash_seed_gives_the_same(seed):
    expect_the_same(play(sys.executable, seed), THIS)


def test_the_stand_ins_give_the_same():
    expect_the_same(play(sys.executable, "0", "stand-ins"), THIS)


@pytest.mark.timeout(900)
def test_every_other_python_on_the_path_gives_the_same(capsys):
    told = {THIS: here()}
    for name in PYTHONS:
        python, missing = prepare(name)
        if missing:
            with capsys.disabled():
                sys.stdout.write(f"\n{name}: {' and '.join(LIBRARIES)} CANNOT BE INSTALLED: {missing}\n")
                sys.stdout.write(f"{name}: the vectors are played with stand-ins in plain Python instead.\n")
        for seed in SEEDS:
            version = (3, int(name.split(".")[1]))
            told[version] = play(python, seed, *(["stand-ins"] if missing else []))
            expect_the_same(told[version], version)
    assert set(told) == {THIS, *((3, int(name.split(".")[1])) for name in PYTHONS)}
    assert len({(found["programs"], found["corpus"], found["fuzzed"]) for found in told.values()}) == 1


def test_pythons_that_do_not_answer_are_not_taken_for_pythons(tmp_path, monkeypatch):
    broken = tmp_path / "python3.29"
    broken.write_text("#!/bin/sh\nexit 127\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert shutil.which("python3.29") == str(broken)
    assert "python3.29" not in find_pythons()
