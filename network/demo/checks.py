"""Checks of the demonstration: name, result and what was seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


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
