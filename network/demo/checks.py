"""The checks of the demonstration: a name, whether it held, and what was seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that must hold."""

    name: str
    ok: bool
    detail: str


@dataclass(slots=True)
class CheckList:
    """All checks of a run, in order; each is told to `listener` as it is made."""

    listener: Callable[[Check], None]
    checks: list[Check] = field(default_factory=list)

    def add(self, name: str, ok: bool, detail: str) -> bool:
        """Record a check and return whether it held."""
        check = Check(name=name, ok=ok, detail=detail)
        self.checks.append(check)
        self.listener(check)
        return ok

    @property
    def ok(self) -> bool:
        """Whether there were checks and all of them held."""
        return bool(self.checks) and all(check.ok for check in self.checks)

    def as_json(self) -> list[dict[str, Any]]:
        """Return the checks as JSON objects."""
        return [asdict(check) for check in self.checks]
