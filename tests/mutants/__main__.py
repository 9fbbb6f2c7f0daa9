"""`python -m tests.mutants [NAME ...] [--json] [--tier default|long] [--list]`: which mistakes does which tier notice?"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from tests.mutants.mutant import Kind, Mutant
from tests.mutants.playground import DEFAULT, LONG, Outcome, Playground, cpu_s
from tests.mutants.table import MUTANTS

DEFAULT_MIN_SHARE = 0.95
"""Of all mutants, so many are killed by `make test`; `make test-long` kills all."""


def main() -> int:
    """Play mutants one after another; exit code 1 if the default tier kills too few, or one survives."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="kinds, or parts of names; all mutants without any")
    parser.add_argument("--json", action="store_true", help="answer in JSON")
    parser.add_argument("--list", action="store_true", help="only say which mutants there are")
    parser.add_argument(
        "--tier",
        choices=(DEFAULT, LONG),
        default=LONG,
        help="`default` leaves survivors alone; `long` tries them again",
    )
    options = parser.parse_args()
    chosen = [mutant for mutant in MUTANTS if not options.names or any(_is_named(mutant, n) for n in options.names)]
    if not chosen:
        parser.error("no mutant has such a name")
    if options.list:
        sys.stdout.writelines(f"{mutant.kind:13} {mutant.name}\n" for mutant in chosen)
        return 0
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        playground = Playground(Path(folder))
        if failure := playground.fails_unchanged(mutant.killed_by for mutant in chosen):
            sys.stderr.write(f"{failure}\nA test fails without any mutant.\n")
            return 1
        outcomes = play_all(playground, chosen, (DEFAULT,) if options.tier == DEFAULT else (DEFAULT, LONG))
    figures = count(outcomes) | {"cpu_s": round(cpu_s(), 1), "wall_s": round(time.monotonic() - began_s, 1)}
    sys.stdout.write(write_json(figures, outcomes) if options.json else write_table(figures, outcomes))
    missed = [outcome for outcome in outcomes if not outcome.killed_in]
    is_strong = figures["default"] >= DEFAULT_MIN_SHARE * len(outcomes)
    return 0 if is_strong and not (missed and options.tier == LONG) else 1


def _is_named(mutant: Mutant, name: str) -> bool:
    return name == mutant.kind or name in mutant.name


def play_all(playground: Playground, mutants: Sequence[Mutant], tiers: Sequence[str]) -> list[Outcome]:
    """Play mutants, telling of each on standard error."""
    outcomes = []
    for number, mutant in enumerate(mutants, 1):
        outcomes.append(outcome := playground.play(mutant, tiers))
        told = outcome.killed_in or "SURVIVED"
        sys.stderr.write(
            f"{number:3} of {len(mutants)}  {told:8} {outcome.cpu_s:5.1f} s  {mutant.kind}: {mutant.name}\n"
        )
        sys.stderr.flush()
    return outcomes


def count(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return how many were killed by which tier, and what playing them took."""
    killed = Counter(outcome.killed_in for outcome in outcomes)
    return {
        "mutants": len(outcomes),
        "default": killed[DEFAULT],
        "long": killed[LONG],
        "survived": killed[""],
        "cpu_s": round(sum(outcome.cpu_s for outcome in outcomes), 1),
    }


def write_json(figures: dict[str, float], outcomes: Sequence[Outcome]) -> str:
    """Return figures and outcomes as JSON."""
    rows = [
        {
            "name": outcome.mutant.name,
            "kind": outcome.mutant.kind,
            "killed_in": outcome.killed_in,
            "killed_by": outcome.mutant.killed_by,
            "cpu_s": round(outcome.cpu_s, 1),
            "wall_s": round(outcome.wall_s, 1),
        }
        for outcome in outcomes
    ]
    return json.dumps({"figures": figures, "mutants": rows}, indent=1) + "\n"


def write_table(figures: dict[str, float], outcomes: Sequence[Outcome]) -> str:
    """Return a line for each kind, one for each mutant that the default tier did not kill, and the figures."""
    lines = ["kind            mutants  default  long  survived    CPU"]
    for kind in Kind:
        own = [outcome for outcome in outcomes if outcome.mutant.kind == kind]
        if own:
            row = count(own)
            lines.append(
                f"{kind:13} {row['mutants']:9} {row['default']:8} {row['long']:5} {row['survived']:9} {row['cpu_s']:6} s"
            )
    lines += [
        f"{outcome.killed_in or 'SURVIVED'}: {outcome.mutant.name} ({outcome.mutant.file})"
        for outcome in outcomes
        if outcome.killed_in != DEFAULT
    ]
    lines.append(", ".join(f"{name} {value}" for name, value in figures.items()))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
