"""Bans of peers that sent what no honest node sends: for a time, twice as long each time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

from consensus.errors import CATALOGUE, BlockRobotError

BAN_FIRST_MS = 2_000
BAN_MAX_MS = 5 * 60_000
FORGOTTEN_AFTER_MS = 30 * 60_000
"""From the end of a peer's last ban until its next one is a first one again."""

log = structlog.get_logger(__name__)


def monotonic_ms() -> int:
    return time.monotonic_ns() // 1_000_000


@dataclass(slots=True)
class _Ban:
    code: str
    detail: str
    count: int
    until_ms: int
    ban_ms: int


class PeerBans:
    """The bans of all peers, by their proven names."""

    def __init__(self, clock_ms: Callable[[], int] = monotonic_ms) -> None:
        """`clock_ms` is monotonic, so clock changes do not affect bans."""
        self.clock_ms = clock_ms
        self._by_peer: dict[str, _Ban] = {}

    def ban(self, peer: str, error: BlockRobotError) -> None:
        """Begin a ban, twice the last; ignored during a ban."""
        known, now_ms = self._by_peer.get(peer), self.clock_ms()
        if known is not None and now_ms < known.until_ms:
            return
        is_first = known is None or now_ms > known.until_ms + FORGOTTEN_AFTER_MS
        ban_ms = BAN_FIRST_MS if is_first or known is None else min(BAN_MAX_MS, 2 * known.ban_ms)
        count = 1 if known is None else known.count + 1
        self._by_peer[peer] = _Ban(error.code, error.detail, count, now_ms + ban_ms, ban_ms)
        log.warning("peer_cut_off", peer=peer, code=error.code, detail=error.detail, count=count, ban_ms=ban_ms)

    def require_not_banned(self, peer: str) -> None:
        """Raise PEER_CUT_OFF while the peer's ban lasts."""
        known, now_ms = self._by_peer.get(peer), self.clock_ms()
        if known is not None and now_ms < known.until_ms:
            detail = f"{peer!r} is not heard for {(known.until_ms - now_ms + 999) // 1000} s more: it sent what no "
            raise BlockRobotError("PEER_CUT_OFF", f"{detail}honest node sends ({known.code}).", peer=peer)

    def until_ms(self, peer: str) -> int:
        """Return when the last ban ends or ended by `clock_ms` (0: none)."""
        known = self._by_peer.get(peer)
        return 0 if known is None else known.until_ms

    def is_banned(self, peer: str) -> bool:
        return peer in self._by_peer and self.clock_ms() < self.until_ms(peer)

    @property
    def count(self) -> int:
        return sum(ban.count for ban in self._by_peer.values())

    def describe(self, wall_ms: int) -> list[dict[str, Any]]:
        """For JSON; `until_ms` is by the wall clock."""
        now_ms = self.clock_ms()
        return [
            {
                "peer": peer,
                "code": ban.code,
                "detail": ban.detail,
                "next_step": CATALOGUE["PEER_CUT_OFF"].next_step,
                "count": ban.count,
                "until_ms": wall_ms + ban.until_ms - now_ms,
            }
            for peer, ban in sorted(self._by_peer.items())
            if now_ms <= ban.until_ms + FORGOTTEN_AFTER_MS
        ]
