"""Where the time of a run of the tests went: by folder and by file, printed at its end. A plugin of pytest."""

from __future__ import annotations

from collections import Counter

import pytest

FILES_SHOWN_COUNT = 30
SHORT_RUN_MAX_S = 60.0
"""Of a run that took less in all, nobody asks."""

_spent_s: Counter[str] = Counter()
_tests_count: Counter[str] = Counter()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up set-up, call and tear-down, of every worker."""
    path = report.nodeid.partition("::")[0]
    _spent_s[path] += report.duration
    _tests_count[path] += report.when == "call"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the table: seconds, tests, place."""
    if _spent_s.total() < SHORT_RUN_MAX_S:
        return
    folders_s: Counter[str] = Counter()
    folders_count: Counter[str] = Counter()
    for path, seconds in _spent_s.items():
        folder = "/".join(path.split("/")[: 3 if path.startswith("tests/unit/") else 2])
        folders_s[folder] += seconds
        folders_count[folder] += _tests_count[path]
    terminalreporter.section("where the time went: seconds, tests, place")
    for folder, seconds in folders_s.most_common():
        terminalreporter.line(f"{seconds:8.1f} {folders_count[folder]:6} {folder}")
    terminalreporter.line("")
    for path, seconds in _spent_s.most_common(FILES_SHOWN_COUNT):
        terminalreporter.line(f"{seconds:8.1f} {_tests_count[path]:6} {path}")
