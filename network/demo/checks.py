"""What a long run tells: its checks with their results, and how often a line of progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

LINE_EVERY_S = 5.0


@dataclass(frozen=True, slots=True)
class Check:
    """One check: name, result, and what was seen."""

    name: str
    ok: bool
    detail: str


@dataclass(slots=True)
class CheckList:
    """All checks of a run, in order; `listener` receives each as made."""

    listener: Callable[[Check], None]
    checks: list[Check] = field(default_factory=list)

    def add(self, name: str, ok: bool, detail: str) -> bool:
        check = Check(name=name, ok=ok, detail=detail)
        self.checks.append(check)
        self.listener(check)
        return ok

    @property
    def ok(self) -> bool:
        return bool(self.checks) and all(check.ok for check in self.checks)


class ProgressThrottle:
    """Passes at most one line per five seconds and stage."""

    def __init__(self) -> None:
        self._told_s = 0.0
        self._stage = ""

    def lets_pass(self, line: str, now_s: float) -> bool:
        """`run: 30 frames seen` is of stage `run`; a line without stage always passes. `now_s` is monotonic."""
        stage = line.rpartition(": ")[0]
        if stage and stage == self._stage and now_s - self._told_s < LINE_EVERY_S:
            return False
        self._stage, self._told_s = stage, now_s
        return True
