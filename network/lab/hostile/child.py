"""Runs the hostile corpus in its own process; prints findings, CPU seconds and peak memory."""

from __future__ import annotations

import hashlib
import json
import resource
import sys
import time
from dataclasses import asdict
from typing import Any

from network.lab.hostile.families import CORPUS
from network.lab.hostile.running import run_program

ADDRESS_SPACE_MAX_BYTES = 1024 * 1024 * 1024
AGAIN_ROUNDS = 2


def run_corpus() -> dict[str, Any]:
    """Findings, CPU seconds by name, memory before and peak."""
    started_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    findings: list[dict[str, Any]] = []
    seconds: dict[str, float] = {}
    everywhere = hashlib.sha256()
    misfits: list[str] = []
    for program in CORPUS:
        started = time.thread_time()
        finding = run_program(program)
        seconds[program.name] = time.thread_time() - started
        findings.append(asdict(finding))
        everywhere.update(repr(finding.everywhere).encode())
        if not finding.fits(program):
            misfits.append(f"{program.name}: {program.expect} was expected, not {finding.came_to}")
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "findings": findings, "misfits": misfits, "seconds": seconds, "started_kib": started_kib, "peak_kib": peak_kib,
        "everywhere": everywhere.hexdigest(),
    }  # fmt: skip


def run_again() -> list[int]:
    peaks: list[int] = []
    for _ in range(AGAIN_ROUNDS):
        for program in CORPUS:
            run_program(program)
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peaks


def main() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_MAX_BYTES, ADDRESS_SPACE_MAX_BYTES))
    result = run_corpus()
    if "--again" in sys.argv:
        result["peaks_kib"] = [result["peak_kib"], *run_again()]
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
