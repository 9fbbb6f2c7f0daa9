"""Fuzzes one parser with atheris: `python -m tests.fuzz TARGET --seconds N --corpus DIR`, after `make install-fuzz`.

It ends at the first finding, whose input is then beside DIR: an exception that is no refusal, a hang, or too much memory.
`--keep` packs what DIR holds into the corpus that the tests play.
"""

from __future__ import annotations

import argparse
import logging
import os
import random
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import atheris
import structlog

from tests.fuzz import corpus
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS, open_target

HANG_MAX_S = 2
MEMORY_MAX_MB = 512
KEPT_MAX_COUNT = 120
LOOPS_MAX_S = 60
INSTRUMENTED = ("clients", "consensus", "node", "contracts", "rosbags", "llrpkit")


def fuzz(name: str, folder: Path, seconds: int) -> None:
    """Hand this process to libFuzzer, which does not give it back."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        target = open_target(name)
    folder.mkdir(parents=True, exist_ok=True)
    for place, data in enumerate([*target.seeds, *corpus.load(name).values()]):
        (folder / f"seed-{place:03d}").write_bytes(data)

    def change(data: bytes, size_max: int, seed: int) -> bytes:
        source = random.Random(seed)
        changed = data
        for _ in range(source.randrange(1, 4)):
            changed = target.mutate(changed, source, _flip) if target.mutate else _flip(changed, source)
        return changed[:size_max]

    arguments = [
        sys.argv[0],
        f"-timeout={LOOPS_MAX_S}",
        f"-rss_limit_mb={MEMORY_MAX_MB}",
        f"-max_len={target.input_max_bytes}",
        "-print_final_stats=1",
        f"-max_total_time={seconds}",
        str(folder),
    ]
    mutator = {"custom_mutator": change} if target.mutate else {}
    atheris.Setup(arguments, _watched(target, folder), **mutator)
    atheris.Fuzz()


def _watched(target: Target, folder: Path) -> Callable[[bytes], None]:
    """Run inputs; what is run now lies in a file, which a finding leaves behind, also one that kills the process."""
    running = folder.with_name(f"{folder.name}-running")

    def run(data: bytes) -> None:
        running.write_bytes(data)
        began_s = time.process_time()
        try:
            target.run(data)
            spent_s = time.process_time() - began_s
            assert spent_s <= HANG_MAX_S, f"{spent_s:.1f} s of CPU for {len(data)} bytes"
        except BaseException:
            sys.stderr.write(f"finding: {running.rename(folder.with_name(f'{folder.name}-finding'))}\n")
            raise

    return run


def _flip(data: bytes, _source: random.Random) -> bytes:
    return bytes(atheris.Mutate(data, max(64, 2 * len(data))))


def keep(name: str, folder: Path) -> None:
    """Pack some of the inputs by which the fuzzer got further, short and long ones, into the corpus of the tests."""
    inputs = sorted((path.read_bytes() for path in folder.iterdir()), key=len)
    chosen = inputs[:: -(-len(inputs) // KEPT_MAX_COUNT)]
    archive = corpus.save(name, chosen)
    sys.stdout.write(f"{len(chosen)} of {len(inputs)} inputs, {archive.stat().st_size} bytes: {archive}\n")


def main() -> None:
    """Fuzz, or keep what was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("target", choices=sorted(TARGETS))
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--corpus", type=Path, default=None, help="where inputs are; by default build/fuzz/TARGET")
    parser.add_argument("--keep", action="store_true", help="pack that folder into the corpus of the tests")
    chosen = parser.parse_args()
    folder = chosen.corpus or Path("build/fuzz") / chosen.target
    os.nice(19 - os.nice(0))
    if chosen.keep:
        keep(chosen.target, folder)
    else:
        spent = resource.getrusage(resource.RUSAGE_SELF)
        sys.stderr.write(f"started after {spent.ru_utime:.1f} s of CPU\n")
        fuzz(chosen.target, folder, chosen.seconds)


if __name__ == "__main__":
    main()
