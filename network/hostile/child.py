"""Runs the corpus in a process of its own and prints what each program came to. Must never have more memory than it says.

Started as `python -m network.hostile.child`: prints one JSON object with the findings, the CPU seconds that each took and
the most memory the process held. The tests start it twice, with different hash seeds, and compare.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from dataclasses import asdict
from typing import Any

from network.hostile.corpus import CORPUS
from network.hostile.running import run_program

ADDRESS_SPACE_MAX_BYTES = 1024 * 1024 * 1024


def run_corpus() -> dict[str, Any]:
    """Run every program; return the findings, seconds of CPU time by name, and the resident memory before and at most."""
    started_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    findings: list[dict[str, Any]] = []
    seconds: dict[str, float] = {}
    misfits: list[str] = []
    for program in CORPUS:
        started = time.thread_time()
        finding = run_program(program)
        seconds[program.name] = time.thread_time() - started
        findings.append(asdict(finding))
        if not finding.fits(program):
            misfits.append(f"{program.name}: {program.expect} was expected, not {finding.came_to}")
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "findings": findings, "misfits": misfits, "seconds": seconds, "started_kib": started_kib, "peak_kib": peak_kib,
    }  # fmt: skip


def main() -> None:
    """Run the corpus under a limit of memory and print the result."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_MAX_BYTES, ADDRESS_SPACE_MAX_BYTES))
    sys.stdout.write(json.dumps(run_corpus()) + "\n")


if __name__ == "__main__":
    main()
