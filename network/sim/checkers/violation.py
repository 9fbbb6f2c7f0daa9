"""The violation type that all checkers return."""

from __future__ import annotations

import msgspec


class Violation(msgspec.Struct, frozen=True):
    """A violation: checker, time (ms), node (-1: whole network), detail."""

    checker: str
    at_ms: float
    node: int
    text: str

    def __str__(self) -> str:
        where = "" if self.node < 0 else f" at node {self.node}"
        return f"{self.checker}{where}, {self.at_ms:.1f} ms: {self.text}"
