"""What documents name is there: tests, files, links; and the documents on data protection leave no row without a test."""

from __future__ import annotations

import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

from consensus.rights.purposes import PURPOSES

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"`(?:tests/)?([a-z0-9_/]+)(?:\.py)?::(test_[a-z0-9_]+)`")
NAMED_LOOSELY = re.compile(r"::\s*test_|test_\w+\s*::")
FILES = re.compile(
    r"(?<![\w/.-])((?:docs|tests|contracts|consensus|node|clients|network)/[\w./*-]+\.(?:py|md|json|svg|png|toml))\b"
)
LINK = re.compile(r"\]\(([^)\s]+)\)")
# Files of a network's folder, not of this repository.
ELSEWHERE = {"network/cluster.json", "network/genesis.json"}
EDPB = "docs/edpb-02-2025.md"
DPIA = "docs/dpia.md"
THREATS = "THREAT_MODEL.md"
OPEN = ("not met", "accepted")


@cache
def documents() -> dict[str, str]:
    """Return every document of the project, by its path."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    return {name: (ROOT / name).read_text(encoding="utf-8") for name in sorted(filter(None, listed.split("\0")))}


@cache
def names_in(path: Path) -> frozenset[str]:
    return (
        frozenset(re.findall(r"def (test_\w+)\(", path.read_text(encoding="utf-8"))) if path.exists() else frozenset()
    )


def missing_tests(text: str) -> list[str]:
    return [
        f"{file}::{test}" for file, test in NAMED.findall(text) if test not in names_in(ROOT / "tests" / f"{file}.py")
    ]


def missing_files(name: str, text: str) -> list[str]:
    """Return the files that a document names or links to, and that are not there."""
    folder = (ROOT / name).parent
    named = [path for path in FILES.findall(text) if path not in ELSEWHERE and not list(ROOT.glob(path))]
    targets = {target: target.partition("#")[0] for target in LINK.findall(text) if "://" not in target}
    linked = [target for target, path in targets.items() if path and not (folder / path).exists()]
    linked += [target for target in targets if target not in linked and not has_heading(folder, ROOT / name, target)]
    return [f"{name}: {path}" for path in (*named, *linked)]


def has_heading(folder: Path, page: Path, target: str) -> bool:
    """Tell whether the place in a page that a link leads to is there; a link to a whole page or another file has none."""
    path, _, anchor = target.partition("#")
    page = folder / path if path else page
    if not anchor or page.suffix != ".md" or not page.exists():
        return True
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return anchor in {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def rows_of(name: str, heading: str) -> list[list[str]]:
    """Return the cells of the rows of the first table behind a heading, without its first two lines."""
    behind = documents()[name].partition(f"\n{heading}\n")[2]
    table = re.search(r"(?:^\|.*\n)+", behind, re.MULTILINE)
    assert table, f"{name} has no table under {heading}"
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.group().splitlines()[2:]]


def is_settled(row: list[str]) -> bool:
    """Tell whether a row names a test, or says in so many words that there is none to name."""
    text = " ".join(row)
    return bool(NAMED.search(text)) or any(word in text.lower() for word in OPEN)


def test_the_checks_find_what_is_not_there() -> None:
    here = "architecture/test_named_in_documents::test_the_checks_find_what_is_not_there"
    assert missing_tests(f"`{here}`, `tests/{here.replace('::', '.py::')}`") == []
    assert missing_tests("`privacy/test_nothing::test_it`, `architecture/test_tidy::test_nobody`") == [
        "privacy/test_nothing::test_it",
        "architecture/test_tidy::test_nobody",
    ]
    text = "tests/no.py, [a](../README.md#figures), [b](../README.md#b), [c](https://example.org), [d](d.md#e)"
    assert missing_files("docs/x.md", text) == [
        "docs/x.md: tests/no.py",
        "docs/x.md: d.md#e",
        "docs/x.md: ../README.md#b",
    ]


@pytest.mark.parametrize("name", documents())
def test_every_test_that_a_document_names_exists(name: str) -> None:
    assert missing_tests(documents()[name]) == []


@pytest.mark.parametrize("name", documents())
def test_every_file_that_a_document_names_exists(name: str) -> None:
    assert missing_files(name, documents()[name]) == []


@pytest.mark.parametrize("name", [EDPB, DPIA, THREATS])
def test_tests_are_named_in_one_form(name: str) -> None:
    """A name in another form would be looked up by nobody."""
    rest = NAMED.sub("", documents()[name])
    assert NAMED_LOOSELY.findall(rest) == []


def test_every_recommendation_has_a_row_that_names_a_test_or_says_what_is_not_met() -> None:
    rows = rows_of(EDPB, "## The recommendations")
    assert [row[0] for row in rows] == [str(number) for number in range(1, 17)]
    assert [row[0] for row in rows if not is_settled(row)] == []


def test_every_requirement_of_the_regulation_names_a_test_or_says_what_is_not_met() -> None:
    rows = rows_of(EDPB, "## Requirements of the GDPR and design choices")
    assert len(rows) > 20
    assert [row[0] for row in rows if not is_settled(row)] == []


def test_every_published_purpose_has_its_lawful_basis() -> None:
    rows = rows_of(DPIA, "### Lawful basis by purpose")
    assert [row[0].strip("`") for row in rows] == list(PURPOSES)
    assert [row[0] for row in rows if "Art. 6" not in " ".join(row) or "Art. 9" not in " ".join(row)] == []


def test_every_risk_has_its_measures_and_what_remains() -> None:
    rows = rows_of(DPIA, "## Risks")
    assert [row[0] for row in rows] == [f"R{number}" for number in range(1, len(rows) + 1)]
    assert len(rows) > 12
    assert [row[0] for row in rows if not is_settled(row)] == []


def test_every_threat_names_a_test_or_is_accepted() -> None:
    rows = rows_of(THREATS, "## By kind of threat (STRIDE)")
    assert {row[0][0] for row in rows} == set("STRIDE")
    assert [row[0] for row in rows] == sorted(
        {row[0] for row in rows}, key=lambda name: ("STRIDE".index(name[0]), int(name[1:]))
    )
    assert [row[0] for row in rows if not is_settled(row)] == []
