"""Parses a source to a syntax tree, tolerating broken lines for authors.

Nodes use `parse_source` only.
"""

from __future__ import annotations

import ast
import gc
import re
import threading
import warnings
from bisect import bisect_right
from typing import Literal

from contracts.vm.frontend.lexer_guard import LogicalLine, Prelexed
from contracts.vm.model.faults import Diagnostic, InternalFault

SYNTAX_ERRORS_MAX_COUNT = 40
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_DEFINITION = re.compile(r"def +([A-Za-z_][A-Za-z0-9_]*)", re.ASCII)
_PARSES_MAX_COUNT = 2
_parsing = threading.RLock()


def parse_alone(source: str, mode: Literal["exec", "eval"] = "exec") -> ast.AST:
    """Run `ast.parse` without a concurrent parse or garbage collection.

    CPython counts tree depth process-wide: parallel parses fail with SystemError (gh-106905). Raises SyntaxError,
    ValueError, or InternalFault if the parser itself fails twice.
    """
    failure: Exception | None = None
    for _ in range(_PARSES_MAX_COUNT):
        with _parsing:
            was_collecting = gc.isenabled()
            gc.disable()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    return ast.parse(source, mode=mode)
            except (MemoryError, RecursionError, SystemError) as error:
                failure = error
            finally:
                if was_collecting:
                    gc.enable()
    raise InternalFault(f"The parser failed on a bounded source: {type(failure).__name__}.") from failure


def parse_source(source: str) -> ast.Module | Diagnostic:
    """Return the tree or Python's objection. Raises InternalFault."""
    try:
        tree = parse_alone(source)
    except SyntaxError as error:
        line, column = error.lineno or 1, max(error.offset or 1, 1)
        return Diagnostic("SYNTAX", line, column, "This is not Python.", f"Python says: {error.msg}.")
    except ValueError as error:
        return Diagnostic("SYNTAX", 1, 1, "This is not Python.", f"Python says: {error}.")
    if not isinstance(tree, ast.Module):
        raise AssertionError("a source parses to a module")
    return tree


def read_what_can_be_read(
    source: str, text: Prelexed, diagnostics: list[Diagnostic]
) -> tuple[ast.Module | None, frozenset[str]]:
    """Return the readable tree (None if nothing is) and names in unreadable lines; adds diagnostics."""
    reader = _Reader(source, text)
    for _ in range(SYNTAX_ERRORS_MAX_COUNT):
        tree = parse_source("\n".join(reader.lines))
        if not isinstance(tree, Diagnostic):
            return tree, frozenset(reader.names)
        if not reader.take_out(tree.line):
            diagnostics.append(tree)
            break
        if reader.newly_broken:
            diagnostics.append(tree)
    return None, frozenset(reader.names)


class _Reader:
    def __init__(self, source: str, text: Prelexed) -> None:
        self.lines = source.split("\n")
        self.names: set[str] = set()
        self.newly_broken = False
        self._logical = text.lines
        self._starts = [line.first for line in text.lines]
        self._taken: dict[int, int] = {}
        if text.unread is not None:
            for number in range(text.unread, len(self.lines) + 1):
                self.names.update(_NAME.findall(self.lines[number - 1]))
                self.lines[number - 1] = ""
        for place, line in enumerate(self._logical):
            if line.broken:
                self._replace(place, line)
        for number in range(len(self.lines)):
            if "\r" in self.lines[number] or "\0" in self.lines[number]:
                self.lines[number] = ""

    def take_out(self, number: int) -> bool:
        place = bisect_right(self._starts, number) - 1
        if place < 0:
            return False
        times = self._taken.get(place, 0)
        self.newly_broken = times == 0
        if times == 0:
            self._replace(place, self._logical[place])
        elif times == 1:
            self._taken[place] = 2
            self._blank(self._logical[place])
        return times < 2

    def _blank(self, line: LogicalLine) -> None:
        for number in range(line.first, min(line.last, len(self.lines)) + 1):
            self.lines[number - 1] = ""

    def _replace(self, place: int, line: LogicalLine) -> None:
        self._taken[place] = 1
        text = "\n".join(self.lines[line.first - 1 : line.last])
        self.names.update(_NAME.findall(text))
        self._blank(line)
        self.lines[line.first - 1] = " " * line.indent + _stand_in(line, text)


def _stand_in(line: LogicalLine, text: str) -> str:
    definition = _DEFINITION.search(text)
    if line.word == "def" and definition is not None:
        return f"def {definition[1]}(): {'' if line.opens else 'pass'}"
    if line.opens:
        return {"elif": "elif None:", "else": "else:", "for": "while None:", "while": "while None:"}.get(
            line.word, "if None:"
        )
    return "pass" if line.indent else ""
