"""Refused links at this node and their reasons, for the operator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import structlog

from consensus.errors import CATALOGUE, BlockRobotError

REPEAT_LOG_MS = 60_000
REFUSALS_KEPT_COUNT = 64
"""Of each kind of source, so that many addresses push no peer out."""
REFUSAL_STANDS_MS = 60_000
LINES_OF_KIND_MAX_COUNT = 10
"""So many lines a minute are logged of each kind of source; the next one after that tells how many were left out."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Refusal:
    detail: str
    since_ms: int
    last_ms: int
    logged_ms: int
    count: int = 1


@dataclass(slots=True)
class _Kind:
    refusals: dict[tuple[str, str], _Refusal] = field(default_factory=dict)  # by peer and code
    since_ms: int = 0
    lines_count: int = 0
    left_out_count: int = 0

    def may_log(self, now_ms: int) -> bool:
        if not 0 <= now_ms - self.since_ms < REPEAT_LOG_MS:
            self.since_ms, self.lines_count = now_ms, 0
        is_allowed = self.lines_count < LINES_OF_KIND_MAX_COUNT
        self.lines_count += is_allowed
        self.left_out_count += not is_allowed
        return is_allowed


class RefusalLog:
    """Refusals by claimed peer name and code, until that peer connects."""

    def __init__(self, event: str) -> None:
        self._event = event
        self._kinds: dict[str, _Kind] = {}

    def note(self, peer: str, error: BlockRobotError, now_ms: int, kind_name: str = "") -> None:
        kind = self._kinds.setdefault(kind_name, _Kind())
        known = kind.refusals.get((peer, error.code))
        if known is not None:
            known.detail, known.last_ms = error.detail, now_ms
            known.count += 1
            if now_ms - known.logged_ms < REPEAT_LOG_MS:
                return
            known.logged_ms = now_ms
        else:
            if len(kind.refusals) >= REFUSALS_KEPT_COUNT:
                del kind.refusals[next(iter(kind.refusals))]
            kind.refusals[peer, error.code] = _Refusal(error.detail, now_ms, now_ms, now_ms)
        if kind.may_log(now_ms):
            left_out = {"left_out": kind.left_out_count} if kind.left_out_count else {}
            kind.left_out_count = 0
            log.warning(
                self._event, peer=peer, code=error.code, detail=error.detail, next_step=error.next_step, **left_out
            )

    def forget(self, peer: str) -> None:
        for kind in self._kinds.values():
            for known in [key for key in kind.refusals if key[0] == peer]:
                del kind.refusals[known]

    def describe(self, now_ms: int) -> list[dict[str, Any]]:
        return [
            {
                "peer": peer,
                "code": code,
                "detail": refusal.detail,
                "next_step": CATALOGUE[code].next_step,
                "since_ms": refusal.since_ms,
                "count": refusal.count,
            }
            for (peer, code), refusal in sorted(
                (item for kind in self._kinds.values() for item in kind.refusals.items()), key=lambda item: item[0]
            )
            if now_ms - refusal.last_ms <= REFUSAL_STANDS_MS
        ]
