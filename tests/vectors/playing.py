"""Plays the golden vectors, random programs both ways, and the hostile ones, in a process of its own; prints what came.

Arguments: the folder of the vectors, and how many programs.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main() -> None:
    sys.path.insert(0, str(HERE.parents[1]))
    from contracts import vectors
    from network.lab.hostile.child import run_corpus
    from network.lab.hostile.fuzzing import fuzz
    from tests.property.both_ways import digest_of_programs, digest_of_readings

    differences = []
    count = 0
    for name, document in vectors.read_vectors(Path(sys.argv[1])).items():
        differences += [[name, row] for row in vectors.compare(document)]
        count += vectors.count(document)
    digest = digest_of_programs(int(sys.argv[2])) + digest_of_readings(4 * int(sys.argv[2]))
    version = list(sys.version_info[:3])
    corpus, found = run_corpus(), fuzz(0, 4 * int(sys.argv[2]))
    told = {
        "version": version, "count": count, "differences": differences, "programs": digest, "misfits": corpus["misfits"],
        "corpus": corpus["everywhere"], "fuzzed": found.everywhere,
    }  # fmt: skip
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main()
