"""Runs random programs and returns one digest of all outcomes.

`python -m network.lab.hostile.fuzzing --seed 1 --programs 1000` prints counts, outcomes and digest as JSON; equal input
gives equal output. `faults` lists unexpected failures and escapes with seed and source.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import resource
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from contracts.lifecycle.registry import PRIVACY_CONTRACTS, read_source
from contracts.vm import VM_CODES
from contracts.vm.model.faults import is_author_code
from network.lab.hostile.families import CORPUS
from network.lab.hostile.grammar import OTHERS, Grammar, mutate
from network.lab.hostile.program import REFUSED, Program
from network.lab.hostile.running import run_program

GAS = 20_000
ADDRESS_SPACE_MAX_BYTES = 2 * 1024 * 1024 * 1024
SPENT_MAX_S = 1.0
"""More CPU time than any program of so little gas, or source of so few bytes, may take on a busy machine."""
_ARGUMENTS: tuple[Any, ...] = (
    0, 1, -5, 2**255, True, None, "", "abc", "\u20ac", b"", b"k" * 33, [], [1, 2, 3], ["b", "a"], {}, {"a": [1]},
    [[1, 2], [3]],
)  # fmt: skip


@dataclass(slots=True)
class Harvest:
    """Fuzzing results. `digest` is equal on one Python version, `everywhere` on all."""

    programs: int = 0
    refused: int = 0
    called: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    faults: list[dict[str, Any]] = field(default_factory=list)
    slowest_s: float = 0.0
    digest: str = ""
    everywhere: str = ""


def make_program(seed: str, sources: list[str]) -> Program:
    chance = random.Random(seed)  # noqa: S311 - programs are to be found again
    kind = chance.randrange(8)
    if kind < 4:
        text = Grammar(chance).source()
    elif kind < 6:
        text = mutate(Grammar(chance).source(), chance, sources)
    else:
        text = mutate(chance.choice(sources), chance, sources)
    arguments = (chance.choice(_ARGUMENTS), chance.choice(_ARGUMENTS))
    mode = "view" if "@view\ndef f(" in text else "export"
    state = {b"k": chance.choice(_ARGUMENTS), b"a": 1}
    return Program(seed, "", text, args=arguments, others=OTHERS, state=state, gas=GAS, mode=mode)


def seed_sources() -> list[str]:
    shipped = [read_source(name) for name in PRIVACY_CONTRACTS]
    return [*shipped, *(program.source for program in CORPUS if len(program.source) < 4000)]


def fuzz(seed: int, count: int) -> Harvest:
    harvest, digest, everywhere, sources = Harvest(), hashlib.sha256(), hashlib.sha256(), seed_sources()
    for number in range(count):
        name = f"{seed}/{number}"
        program = make_program(name, sources)
        harvest.programs += 1
        started = time.thread_time()
        try:
            finding = run_program(program)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            harvest.faults.append({"seed": name, "fault": f"{type(error).__name__}: {error}", "source": program.source})
            continue
        spent = time.thread_time() - started
        harvest.slowest_s = max(harvest.slowest_s, spent)
        if spent > SPENT_MAX_S:
            harvest.faults.append({"seed": name, "fault": f"took {spent:.1f} s", "source": program.source})
        refused = finding.came_to.startswith(REFUSED)
        harvest.refused += refused
        harvest.called += not refused
        if not refused:
            harvest.codes[finding.came_to] += 1
            if finding.came_to not in VM_CODES and not is_author_code(finding.came_to):
                harvest.faults.append({"seed": name, "fault": f"code {finding.came_to}", "source": program.source})
        digest.update(f"{finding.came_to} {finding.gas_used} {finding.digest} {finding.places}\n".encode())
        everywhere.update(repr(finding.everywhere).encode())
    harvest.digest, harvest.everywhere = digest.hexdigest(), everywhere.hexdigest()
    return harvest


def main() -> None:
    """Fuzz under a memory limit; exit with 1 if the machine failed."""
    parser = argparse.ArgumentParser(description="Run contracts made by chance.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--programs", type=int, default=1000)
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_MAX_BYTES, ADDRESS_SPACE_MAX_BYTES))
    found = fuzz(given.seed, given.programs)
    sys.stdout.write(
        json.dumps(
            {
                "programs": found.programs, "refused": found.refused, "called": found.called, "codes": dict(found.codes),
                "slowest_s": round(found.slowest_s, 3), "digest": found.digest, "faults": found.faults,
            }
        )
        + "\n"
    )  # fmt: skip
    sys.exit(1 if found.faults else 0)


if __name__ == "__main__":
    main()
