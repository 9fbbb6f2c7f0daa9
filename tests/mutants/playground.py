"""A copy of the tracked tree, in which one mutant at a time is played."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.mutant import Mutant, apply_to

ROOT = Path(__file__).resolve().parents[2]
RUN_MAX_S = 600
DEFAULT_TIER = "not long"


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant: the tier that killed it, or nothing."""

    name: str
    killed_in: str
    seconds: float


class Playground:
    """The copy. What its tests import is the copy: `pythonpath` of pytest puts its root first."""

    def __init__(self, folder: Path) -> None:
        """Copy every tracked file of the working tree."""
        self.folder = folder
        listed = subprocess.run(("git", "ls-files", "-z"), cwd=ROOT, capture_output=True, check=True).stdout
        for name in filter(None, listed.decode().split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / name, folder / name)

    def passes(self, tests: str, tier: str) -> bool:
        """Run tests of a tier in the copy until one fails. Raises ValueError if none was there to run."""
        done = subprocess.run(
            (sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", tier, *tests.split()),
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            timeout=RUN_MAX_S,
            text=True,
            check=False,
        )
        if done.returncode not in {0, 1}:
            raise ValueError(f"{tests}: pytest ended with {done.returncode}: {done.stdout[-500:]}")
        return done.returncode == 0

    def play(self, mutant: Mutant) -> Outcome:
        """Apply a mutant, run its tests tier by tier, take it back."""
        path, began_s = self.folder / mutant.file, time.monotonic()
        original = path.read_text(encoding="utf-8")
        path.write_text(apply_to(mutant, self.folder), encoding="utf-8")
        try:
            if not self._survives(mutant, DEFAULT_TIER):
                killed_in = "default"
            else:
                killed_in = "" if self._survives(mutant, "long or not long") else "long"
        finally:
            path.write_text(original, encoding="utf-8")
        return Outcome(mutant.name, killed_in, time.monotonic() - began_s)

    def _survives(self, mutant: Mutant, tier: str) -> bool:
        try:
            return self.passes(mutant.killed_by, tier)
        except ValueError:
            return False  # the tests cannot even be collected with it
