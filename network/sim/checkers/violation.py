"""What a checker finds."""

from __future__ import annotations

import msgspec


class Violation(msgspec.Struct, frozen=True):
    """A broken promise: which checker, when (ms), at which node (-1: of the whole), and what."""

    checker: str
    at_ms: float
    node: int
    text: str

    def __str__(self) -> str:
        where = "" if self.node < 0 else f" at node {self.node}"
        return f"{self.checker}{where}, {self.at_ms:.1f} ms: {self.text}"
