"""Every row of every Markdown table has as many cells as its head: what is shifted by a column tells something false."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from node.api.openapi.markdown_tables import write_table

ROOT = Path(__file__).resolve().parents[2]
BAR = re.compile(r"(?<!\\)\|")
RULE = re.compile(r":?-+:?")


def markdown_files() -> list[str]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return sorted(name for name in listed.stdout.split("\0") if name and (ROOT / name).exists())


def cells_of(line: str) -> list[str]:
    """Return the cells as GitHub's Markdown counts them: a `|` separates, in code too, unless a backslash is before it."""
    return [cell.strip() for cell in BAR.split(line.strip().removeprefix("|").removesuffix("|"))]


def shifted_rows(text: str) -> tuple[int, list[str]]:
    """Return how many tables a text has, and what is wrong with them."""
    wrong, count, width, fenced = [], 0, 0, False
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        fenced ^= line.lstrip().startswith(("```", "~~~"))
        if fenced or not line.lstrip().startswith("|"):
            width = 0
            continue
        cells = cells_of(line)
        if not width:
            width, count = len(cells), count + 1
            below = cells_of(lines[number]) if number < len(lines) else []
            if len(below) != width or not all(map(RULE.fullmatch, below)):
                wrong.append(f"{number}: the head has no rule of {width} columns under it")
        elif len(cells) != width:
            wrong.append(f"{number}: {len(cells)} cells under {width} heads: {line[:80]}")
    return count, wrong


def test_the_check_finds_what_is_shifted() -> None:
    assert shifted_rows("| a | b |\n|---|---|\n| `x \\| y` | 2 |\n") == (1, [])
    assert shifted_rows("```\n| a |\n```\n") == (0, [])
    assert len(shifted_rows("| a | b |\n|---|---|\n| `x | y` | 2 |\n")[1]) == 1
    assert len(shifted_rows("| a | b |\n|---|---|\n| 1 |\n")[1]) == 1
    assert len(shifted_rows("| a | b |\n|---|\n")[1]) == 2


def test_every_table_of_every_document_is_straight_also_when_it_is_written() -> None:
    found = {name: shifted_rows((ROOT / name).read_text(encoding="utf-8")) for name in markdown_files()}
    assert sum(count for count, _ in found.values()) > 100
    assert [f"{name}:{line}" for name, (_, wrong) in found.items() for line in wrong] == []
    assert shifted_rows("\n".join(write_table(["a", "b"], [["x | y", "2"]]))) == (1, [])
    with pytest.raises(ValueError, match="3 cells under 2 heads"):
        write_table(["a", "b"], [["1", "2", "3"]])
