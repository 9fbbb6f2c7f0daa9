"""Text of others takes one way: lines are split by one function, terminals and pages show no control."""

from __future__ import annotations

import re
from pathlib import Path

from network.cli.main import main
from network.cli.root_group import RootGroup
from tests.architecture.test_tidy import ROOT, matches, modules, place

VISIBLE_TEXT = ROOT / "consensus" / "visible_text.py"
SAFE_OUTPUT = ROOT / "clients" / "sdk" / "terminal" / "safe_output.py"
TERMINAL = ROOT / "clients" / "sdk" / "terminal" / "terminal.py"
OTHER_LINE_ENDS = re.compile(r"\.split\(/\\r|\\u2028|\\u2029|\.split\(/.*\\R")


def scripts() -> tuple[Path, ...]:
    found = (path for folder in ("pages", "node", "clients", "network") for path in (ROOT / folder).rglob("*.js"))
    return tuple(sorted(found))


def test_lines_are_split_by_one_function_and_on_pages_at_a_line_feed_alone() -> None:
    """`str.splitlines` also splits at U+0085, U+2028 and six more, where no line of a source ends."""
    assert matches([path for path in modules() if path != VISIBLE_TEXT], re.compile(r"\bsplitlines\b")) == []
    assert len(scripts()) > 20
    assert [place(path) for path in scripts() if OTHER_LINE_ENDS.search(path.read_text(encoding="utf-8"))] == []


def test_one_module_makes_the_console_and_one_function_overwrites_progress() -> None:
    """Any other `Console` would print text of others raw."""
    raw = re.compile(
        r"(?<!Safe)(?<!Live)\bConsole\(|\bfrom rich import print\b|(?<![\w.])print\(|click\.style\(|secho\("
    )
    hostile = ROOT / "network" / "lab" / "hostile" / "families"
    assert matches([path for path in modules() if path != SAFE_OUTPUT and path.parent != hostile], raw) == []
    # Controls that are written to a safe stream would be shown as escapes.
    moves = re.compile(r"[\"']\\r[^\"'\\]|\\x1b\[")
    assert matches([path for path in modules() if path not in (SAFE_OUTPUT, TERMINAL)], moves) == []


def test_one_module_goes_around_the_safe_streams() -> None:
    """What was written past them, or to them by their numbers, would reach the terminal as others wrote it."""
    around = re.compile(
        r"sys\.__std|os\.write\([12]\b|open\(['\"]?/dev/(?:tty|std)|stdout\.buffer|stderr\.buffer|\.trusted\b"
    )
    allowed = (SAFE_OUTPUT, TERMINAL)
    assert matches([path for path in modules() if path not in allowed], around) == []
    assert len(matches([TERMINAL], re.compile(r"\bwrite_trusted\("))) == 1, "only to wipe the screen"


def test_the_root_command_makes_its_streams_safe() -> None:
    text = (ROOT / "network" / "cli" / "root_group.py").read_text(encoding="utf-8")
    assert "with safe_streams():" in text
    assert 'blockrobot = "network.cli.main:main"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert isinstance(main, RootGroup)


def test_pages_make_text_of_others_safe() -> None:
    """All text of a page comes through `h`, `s` and `replace` of dom.js, which escape what moves it."""
    raw = re.compile(r"createTextNode|innerHTML|outerHTML|insertAdjacentHTML|document\.write")
    dom = ROOT / "pages" / "assets" / "dom.js"
    found = [place(path) for path in scripts() if path != dom and raw.search(path.read_text(encoding="utf-8"))]
    assert found == []
    assert len(matches((dom,), re.compile(r"createTextNode\((?!visible\()"))) == 0
