"""Where the time of one `records.record` goes: samples of the running interpreter.

A timer of the process's CPU time interrupts the calls a thousand times a second; each sample counts for the innermost
function that belongs to one of the groups. Nothing is wrapped or traced, so that the shares are those of a plain run.
"""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Callable
from pathlib import PurePath
from types import FrameType

SAMPLE_EVERY_S = 0.001
_GROUPS = {
    "encoding.py": "values: encode, decode",
    "shapes.py": "values: encode, decode",
    "values.py": "values: walk, copy, charge",
    "host.py": "host functions",
    "invoke.py": "entry of calls",
    "abi.py": "entry of calls",
    "meter.py": "meter",
    "closures.py": "interpreter: expressions",
    "compiler_expressions.py": "interpreter: expressions",
    "compiler_statements.py": "interpreter: statements",
    "operations.py": "interpreter: operators, functions, methods",
    "builtins_table.py": "interpreter: operators, functions, methods",
    "methods.py": "interpreter: operators, functions, methods",
    "vm.py": "state in memory, the benchmark itself",
}


def group_of(frame: FrameType | None) -> str:
    """Return the group that a sample counts for: that of its innermost function that has one."""
    while frame is not None:
        code = frame.f_code
        name = PurePath(code.co_filename).name
        if name == "host.py" and code.co_name.startswith("_state_"):
            return f"host functions: state.{code.co_name.removeprefix('_state_')}"
        if name in _GROUPS:
            return _GROUPS[name]
        frame = frame.f_back
    return "other"


def sample_shares(run: Callable[[], object], batches: int) -> dict[str, float]:
    """Call `run` so many times and return the share (0 to 1) of the CPU time that each group took, largest first.

    Only in the main thread of a process, as all signals.
    """
    samples: Counter[str] = Counter()

    def note(_: int, frame: FrameType | None) -> None:
        samples[group_of(frame)] += 1

    before = signal.signal(signal.SIGPROF, note)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_EVERY_S, SAMPLE_EVERY_S)
    try:
        for _ in range(batches):
            run()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    total = sum(samples.values())
    return {group: count / total for group, count in samples.most_common()}
