"""A copy of the tree, in which one mutant at a time is played.

The tests run by a Python of its own, an environment that finds the copy before the packages installed with us: so a
process that they start imports the copy too, also with `-I`, which looks at no `PYTHONPATH`.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sysconfig
import time
import venv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.mutant import Mutant, apply_to

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("clients", "consensus", "contracts", "network", "node", "pages", "tests")
RUN_MAX_S = 600
DEFAULT, LONG = "default", "long"
_MARKERS = {DEFAULT: "not long", LONG: "long or not long"}
_ALL_PASSED, _NONE_CHOSEN = 0, 5
"""Exit codes of pytest."""


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant: the tier that killed it, or nothing; and what that cost."""

    mutant: Mutant
    killed_in: str
    cpu_s: float
    wall_s: float


class Playground:
    """The copy, and the Python that runs its tests."""

    def __init__(self, folder: Path) -> None:
        """Copy every file of the working tree that git tracks or would track."""
        self.tree, python = folder / "tree", folder / "python"
        listing = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        listed = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True).stdout
        for name in filter(None, listed.decode().split("\0")):
            if (ROOT / name).is_file():
                (self.tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / name, self.tree / name)
        venv.create(python, symlinks=True)
        self.python = python / "bin" / "python"
        (packages,) = python.glob("lib/python*/site-packages")
        (packages / "mutants.pth").write_text(f"{self.tree}\n{sysconfig.get_path('purelib')}\n", encoding="utf-8")

    def find_packages(self, *options: str) -> list[Path]:
        """Return where a process that a test would start imports our packages from."""
        code = (
            f"import {', '.join(PACKAGES)}; print(*(each.__path__[0] for each in ({', '.join(PACKAGES)})), sep='\\n')"
        )
        return [Path(path) for path in self._start((*options, "-c", code), check=True).stdout.splitlines()]

    def fails_unchanged(self, tests: Iterable[str]) -> str:
        """Run tests of the default tier without any mutant; return what pytest says if one fails, or nothing."""
        chosen = sorted({name for line in tests for name in line.split()})
        done = self._run(chosen, DEFAULT)
        return "" if done.returncode == _ALL_PASSED else done.stdout

    def play(self, mutant: Mutant, tiers: Iterable[str]) -> Outcome:
        """Apply a mutant, run its tests tier by tier until one fails, take it back."""
        path, began_s, before_s = self.tree / mutant.file, time.monotonic(), cpu_s()
        original = path.read_text(encoding="utf-8")
        changed = apply_to(mutant, self.tree)
        _write(path, changed)
        try:
            killed_in = next((tier for tier in tiers if self._is_killed(mutant, tier)), "")
        finally:
            _write(path, original)
        return Outcome(mutant, killed_in, cpu_s() - before_s, time.monotonic() - began_s)

    def _is_killed(self, mutant: Mutant, tier: str) -> bool:
        """Tell whether a test fails; also if the tests cannot be collected any more, or do not come to an end."""
        try:
            done = self._run(mutant.killed_by.split(), tier)
        except subprocess.TimeoutExpired:
            return True
        return done.returncode not in {_ALL_PASSED, _NONE_CHOSEN}

    def _run(self, tests: Iterable[str], tier: str) -> subprocess.CompletedProcess[str]:
        return self._start(("-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", _MARKERS[tier], *tests))

    def _start(self, arguments: Iterable[str], *, check: bool = False) -> subprocess.CompletedProcess[str]:
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "PYTHON"))}
        return subprocess.run(
            (self.python, *arguments),
            cwd=self.tree,
            env=environment,
            capture_output=True,
            timeout=RUN_MAX_S,
            text=True,
            check=check,
        )


def cpu_s() -> float:
    """Return what all processes that have ended took, those without a mutant too."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _write(path: Path, source: str) -> None:
    """Write a module. What was compiled of it goes too: a change within a second, of equal length, is not noticed."""
    path.write_text(source, encoding="utf-8")
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()
