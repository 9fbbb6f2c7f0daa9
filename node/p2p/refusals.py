"""Which links are refused at this node, and why: for the operator. Must never fill a log with what it said before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import structlog

from consensus.errors import CATALOGUE, BlockRobotError

REPEAT_LOG_MS = 60_000
REFUSALS_KEPT_COUNT = 64
REFUSAL_STANDS_MS = 60_000

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Refusal:
    code: str
    detail: str
    since_ms: int
    last_ms: int
    logged_ms: int


class Refusals:
    """The newest refusal of each peer by its claimed name, until that peer is connected."""

    def __init__(self, event: str) -> None:
        self._event = event
        self._by_peer: dict[str, _Refusal] = {}

    def note(self, peer: str, error: BlockRobotError, now_ms: int) -> None:
        """Take down a refusal; it is logged when it is new, and once a minute after that."""
        known = self._by_peer.get(peer)
        if known is not None and known.code == error.code:
            known.detail, known.last_ms = error.detail, now_ms
            if now_ms - known.logged_ms < REPEAT_LOG_MS:
                return
            known.logged_ms = now_ms
        else:
            if known is None and len(self._by_peer) >= REFUSALS_KEPT_COUNT:
                del self._by_peer[next(iter(self._by_peer))]
            self._by_peer[peer] = _Refusal(error.code, error.detail, now_ms, now_ms, now_ms)
        log.warning(self._event, peer=peer, code=error.code, detail=error.detail, next_step=error.next_step)

    def forget(self, peer: str) -> None:
        """The peer is connected, or is of no interest any more."""
        self._by_peer.pop(peer, None)

    def describe(self, now_ms: int) -> list[dict[str, Any]]:
        """Return all refusals that stand, ready for JSON: those of the last minute, since whoever is refused tries on."""
        return [
            {
                "peer": peer,
                "code": refusal.code,
                "detail": refusal.detail,
                "next_step": CATALOGUE[refusal.code].next_step,
                "since_ms": refusal.since_ms,
            }
            for peer, refusal in sorted(self._by_peer.items())
            if now_ms - refusal.last_ms <= REFUSAL_STANDS_MS
        ]
