"""Says which tests were left out because the user said so, and holds every answer against its reference.

A test must never depend on the language that the developer's system speaks.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from typing import Any

import click
import pytest

from clients.sdk.terminal import terminal
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE
from tests.frozen_heap import freeze

pytest_plugins = ("tests.spent_time", "tests.tiers")

LEFT_OUT_BY = {
    "system_packages": (
        "they need Debian's chromium, graphviz, opencv-doc, prometheus, rospy or umoci (SYSTEM_PACKAGES=none).",
        "To run them: make test, as root or with sudo without a password; or install the packages first.",
    ),
    "ros2": (
        "they need wheels of ROS 2, and a network of their own (ROS2=none).",
        "To run them: make test, with Python 3.11 on Linux (x86-64), as root or where users may have namespaces.",
    ),
    "hosts": (
        "they make network namespaces (HOSTS=none).",
        "To run them: make test-long, as root on Linux, with iproute2.",
    ),
}
"""What is said of tests with a marker: what they need, and how to run them."""

SPOKEN_BY = (LANGUAGE_VARIABLE, "LANGUAGE", "LC_ALL", "LC_CTYPE", "LC_MESSAGES", "LANG")
"""What an environment names its language and its letters with."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A suite that was started in the background ignores Ctrl-C, and so would every program that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)

_left_out: dict[str, list[str]] = {marker: [] for marker in LEFT_OUT_BY}


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Note who was left out, where `-m` named a marker."""
    told = items[0].config.getoption("markexpr") if items else ""
    asked_for = [item for item in items if "not long" not in told or not item.get_closest_marker("long")]
    for marker, names in _left_out.items():
        if f"not {marker}" in told:
            names.extend(item.nodeid for item in asked_for if item.get_closest_marker(marker))


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over the tests themselves."""
    freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many, where they are, and how to run them."""
    for marker, names in _left_out.items():
        if not names:
            continue
        files = sorted({name.partition("::")[0] for name in names})
        needed, way_in = LEFT_OUT_BY[marker]
        terminalreporter.section("left out", yellow=True)
        terminalreporter.line(f"{len(names)} tests were NOT run: {needed}")
        terminalreporter.line(f"They are in: {', '.join(files)}")
        terminalreporter.line(way_in)


@pytest.fixture(scope="session", autouse=True)
def no_language_is_named() -> Iterator[None]:
    """Take away what the developer's system speaks. Of the session: networks that a module shares begin after it."""
    with pytest.MonkeyPatch.context() as patch:
        for variable in SPOKEN_BY:
            patch.delenv(variable, raising=False)
        yield


@pytest.fixture(autouse=True)
def answers_are_as_documented() -> Iterator[None]:
    """Hold every answer that a command prints with --json in this process against the reference page of them.

    By a patch of its own: a test that undoes its patches before it ends would end this too.
    """
    wrong: list[str] = []
    write = terminal.write_json

    def noting(value: Any) -> str:
        context = click.get_current_context(silent=True)
        if context is not None:
            from tests.json_answers import differences, words_of

            wrong.extend(differences(words_of().get(id(context.command), ""), value))
        return write(value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "write_json", noting)
        yield
    assert wrong == [], "docs/reference/json-output.md says otherwise"
