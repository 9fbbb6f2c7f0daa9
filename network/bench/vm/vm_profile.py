"""Samples where the CPU time of `records.record` goes, 1000 times a second, untraced."""

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
    """Return each group's CPU share (0 to 1), largest first; main thread only."""
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
