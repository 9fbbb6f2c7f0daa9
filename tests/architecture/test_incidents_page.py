"""docs/explanation/incidents.md names tests that exist, for every class of incident."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "explanation" / "incidents.md"
CLASSES = [
    f"{letter}{number}" for letter, count in (("A", 14), ("C", 7), ("B", 3), ("F", 6)) for number in range(1, count + 1)
]
NAMED = re.compile(r"`([a-z0-9_/]+)::(test_[a-z0-9_]+)`")


def test_every_class_of_incident_stands_on_the_page_with_a_test() -> None:
    rows = dict(re.findall(r"^\| ([A-F]\d+) \|(.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert list(rows) == CLASSES
    assert [name for name, row in rows.items() if not NAMED.search(row)] == []


def test_every_test_that_the_page_names_exists() -> None:
    named = NAMED.findall(PAGE.read_text(encoding="utf-8"))
    assert len(named) > len(CLASSES)
    missing = []
    for file, test in named:
        path = ROOT / "tests" / f"{file}.py"
        if not path.exists() or not re.search(rf"def {test}\(", path.read_text(encoding="utf-8")):
            missing.append(f"{file}::{test}")
    assert missing == []
