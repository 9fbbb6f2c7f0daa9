"""All mutants, by where they are. README.md tells how the tables beside this module are written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from tests.mutants.mutant import DroppedCheck, Kind, Mutant, Replaced

_HEAD = re.compile(r"^@ (.*)\n", re.MULTILINE)
_DROPPED = re.compile(r"^([A-Z_]+)((?: \d+)+)\n", re.MULTILINE)
_REPLACED = re.compile(r"^([^-+@\n].*)\n((?:-.*\n)+)((?:\+.*\n)*)", re.MULTILINE)


def read_mutants(table: str) -> Iterator[Mutant]:
    """Yield the mutants that a table tells. Raises ValueError if a line of it is none of a mutant's."""
    if rest := _HEAD.sub("", _REPLACED.sub("", _DROPPED.sub("", table))).strip():
        raise ValueError(f"no mutant: {rest}")
    for group in table.split("\n\n"):
        name_of_kind, file, *tests = " ".join(_HEAD.findall(group)).split()
        kind, killed_by, lines = Kind(name_of_kind), " ".join(tests), group.rstrip("\n") + "\n"
        for code, numbers in _DROPPED.findall(lines):
            yield from (DroppedCheck(kind, file, code, int(number), killed_by) for number in numbers.split())
        for name, old, new in _REPLACED.findall(lines):
            # Without a new line, the old ones go with their ends.
            yield Replaced(kind, file, name, _text_of(old) + "\n" * (not new), _text_of(new), killed_by)


def _text_of(lines: str) -> str:
    return "\n".join(line[1:] for line in lines.removesuffix("\n").split("\n"))


MUTANTS = tuple(
    mutant
    for path in sorted(Path(__file__).parent.glob("*.txt"))
    for mutant in read_mutants(path.read_text(encoding="utf-8"))
)
