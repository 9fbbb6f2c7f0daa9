"""Pauses for peers that sent what no honest node sends; each doubles."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

from consensus.errors import CATALOGUE, BlockRobotError

PAUSE_FIRST_MS = 2_000
PAUSE_MAX_MS = 5 * 60_000
FORGOTTEN_AFTER_MS = 30 * 60_000
"""From the end of a peer's last pause until its next one is a first one again."""

log = structlog.get_logger(__name__)


def monotonic_ms() -> int:
    return time.monotonic_ns() // 1_000_000


@dataclass(slots=True)
class _Penalty:
    code: str
    detail: str
    count: int
    until_ms: int
    pause_ms: int


class Penalties:
    """The pauses of all peers, by their proven names."""

    def __init__(self, clock_ms: Callable[[], int] = monotonic_ms) -> None:
        """`clock_ms` is monotonic, so clock changes do not affect pauses."""
        self.clock_ms = clock_ms
        self._by_peer: dict[str, _Penalty] = {}

    def punish(self, peer: str, error: BlockRobotError) -> None:
        """Begin a pause, twice the last; ignored during a pause."""
        known, now_ms = self._by_peer.get(peer), self.clock_ms()
        if known is not None and now_ms < known.until_ms:
            return
        is_first = known is None or now_ms > known.until_ms + FORGOTTEN_AFTER_MS
        pause_ms = PAUSE_FIRST_MS if is_first or known is None else min(PAUSE_MAX_MS, 2 * known.pause_ms)
        count = 1 if known is None else known.count + 1
        self._by_peer[peer] = _Penalty(error.code, error.detail, count, now_ms + pause_ms, pause_ms)
        log.warning("peer_cut_off", peer=peer, code=error.code, detail=error.detail, count=count, pause_ms=pause_ms)

    def require_none(self, peer: str) -> None:
        """Raise PEER_CUT_OFF while the peer's pause lasts."""
        known, now_ms = self._by_peer.get(peer), self.clock_ms()
        if known is not None and now_ms < known.until_ms:
            detail = f"{peer!r} is not heard for {(known.until_ms - now_ms + 999) // 1000} s more: it sent what no "
            raise BlockRobotError("PEER_CUT_OFF", f"{detail}honest node sends ({known.code}).", peer=peer)

    def until_ms(self, peer: str) -> int:
        """Return when the last pause ends or ended by `clock_ms` (0: none)."""
        known = self._by_peer.get(peer)
        return 0 if known is None else known.until_ms

    def is_paused(self, peer: str) -> bool:
        return peer in self._by_peer and self.clock_ms() < self.until_ms(peer)

    @property
    def count(self) -> int:
        return sum(penalty.count for penalty in self._by_peer.values())

    def describe(self, wall_ms: int) -> list[dict[str, Any]]:
        """Return recent pauses for JSON; `until_ms` is by the wall clock."""
        now_ms = self.clock_ms()
        return [
            {
                "peer": peer,
                "code": penalty.code,
                "detail": penalty.detail,
                "next_step": CATALOGUE["PEER_CUT_OFF"].next_step,
                "count": penalty.count,
                "until_ms": wall_ms + penalty.until_ms - now_ms,
            }
            for peer, penalty in sorted(self._by_peer.items())
            if now_ms <= penalty.until_ms + FORGOTTEN_AFTER_MS
        ]
