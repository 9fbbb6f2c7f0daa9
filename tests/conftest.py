"""Says at the end which tests were left out for want of Debian packages: never a silence about them."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

MARKER = "system_packages"
_left_out: list[str] = []


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Note who was left out, where `-m` named the marker."""
    if items and f"not {MARKER}" in items[0].config.getoption("markexpr"):
        _left_out.extend(item.nodeid for item in items if item.get_closest_marker(MARKER))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many, where they are, and how to run them."""
    if not _left_out:
        return
    files = sorted({name.partition("::")[0] for name in _left_out})
    terminalreporter.section("left out", yellow=True)
    terminalreporter.line(
        f"{len(_left_out)} tests were NOT run: they need Debian's chromium, graphviz or opencv-doc (SYSTEM_PACKAGES=none)."
    )
    terminalreporter.line(f"They are in: {', '.join(files)}")
    terminalreporter.line(
        "To run them: make test, as root or with sudo without a password; or install the packages first."
    )
