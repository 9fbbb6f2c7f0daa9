"""`python -m tests.mutants [NAME ...] [--json]`: which tier of the tests misses what mistake."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from tests.mutants.playground import DEFAULT_TIER, Playground
from tests.mutants.table import MUTANTS

DEFAULT_MIN_SHARE = 0.95
"""Of all mutants, so many are killed by `make test`; `make test-long` kills all."""


def main() -> int:
    """Play mutants one after another; exit code 1 if the default tier kills too few, or one survives."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of names; all mutants without any")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    chosen = [mutant for mutant in MUTANTS if not options.names or any(name in mutant.name for name in options.names)]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        playground = Playground(Path(folder))
        for tests in sorted({mutant.killed_by for mutant in chosen}):
            if not playground.passes(tests, DEFAULT_TIER):
                sys.stderr.write(f"{tests} fails without any mutant.\n")
                return 1
        outcomes = []
        for number, mutant in enumerate(chosen, 1):
            outcomes.append(outcome := playground.play(mutant))
            told = outcome.killed_in or "SURVIVED"
            sys.stderr.write(f"{number:3} of {len(chosen)}  {told:8} {outcome.seconds:5.1f} s  {mutant.name}\n")
    killed = {tier: sum(outcome.killed_in == tier for outcome in outcomes) for tier in ("default", "long", "")}
    figures = {"mutants": len(chosen), "default": killed["default"], "long": killed["long"], "survived": killed[""]}
    rows = [{"name": outcome.name, "killed_in": outcome.killed_in, "seconds": outcome.seconds} for outcome in outcomes]
    sys.stdout.write(json.dumps({"figures": figures, "mutants": rows} if options.json else figures) + "\n")
    return 0 if killed["default"] >= DEFAULT_MIN_SHARE * len(chosen) and not killed[""] else 1


if __name__ == "__main__":
    sys.exit(main())
