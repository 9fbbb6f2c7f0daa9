"""A measurement that shares its work with processes ends when it is told to, and leaves none of them behind."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from network.bench.processes import worker_pool
from tests.benchmarks.long_work import WORK_MAX_S

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import signal, sys
from network.bench.processes import worker_pool
from tests.benchmarks.long_work import work_long

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with worker_pool(2) as pool:
        jobs = [pool.submit(work_long, sys.argv[1], number) for number in range(4)]
        print([job.result() for job in jobs])
"""


def is_at_work(pid: str) -> bool:
    try:
        return (Path("/proc") / pid / "cmdline").read_bytes() != b""  # a dead one that nobody has asked after has none
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize(("number", "codes"), [(signal.SIGTERM, {143}), (signal.SIGINT, {1, -2, 130})])
def test_workers_end_with_the_measurement(tmp_path: Path, number: signal.Signals, codes: set[int]) -> None:
    program = tmp_path / "measurement.py"
    program.write_text(PROGRAM)
    child = subprocess.Popen(
        [sys.executable, program, tmp_path], cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, stderr=subprocess.DEVNULL
    )
    try:
        began = time.monotonic()
        while len(workers := list(tmp_path.glob("began-*"))) < 2:
            assert time.monotonic() < began + WORK_MAX_S, "the workers did not begin"
            assert child.poll() is None
        child.send_signal(number)
        assert child.wait(timeout=WORK_MAX_S / 4) in codes
    finally:
        child.kill()
    assert [path.name for path in workers if is_at_work(path.name.removeprefix("began-"))] == []


def test_what_workers_found_comes_back() -> None:
    with worker_pool(2) as pool:
        assert list(pool.map(abs, [-1, 2, -3])) == [1, 2, 3]
