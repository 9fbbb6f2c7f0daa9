"""Plans which transactions make room for a new one in a full mempool."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Generic

from consensus.errors import BlockRobotError
from contracts.execution.sender_admission import Account
from node.mempool.lane import Lane, W

EVICTION_FACTOR = 4
"""How many times as much an account has waiting, at least, that makes room for another in a full pool."""


class EvictionPlan(Generic[W]):
    """Transactions that a newcomer replaces, newest first, by three cumulative rules.

    From accounts `EVICTION_FACTOR` times larger; for a member, from visits that much larger together; for a visit, from
    others no smaller (its first: from those a quarter its size).
    """

    def __init__(self, lanes: Sequence[Lane[W]], wanted_bytes: int) -> None:
        self._lanes = lanes
        self._wanted_bytes = wanted_bytes
        self._freed_bytes = 0
        self._freed: tuple[Counter[str], ...] = tuple(Counter() for _ in lanes)
        self._txids: dict[bytes, None] = {}

    def choose(self, account: Account, own_bytes: int, *, is_first: bool) -> Collection[bytes]:
        """Return txids to evict. Raises MEMPOOL_FULL.

        `own_bytes`: the account's waiting total; `is_first`: the newcomer alone.
        """
        for lane, freed in zip(self._lanes, self._freed, strict=True):
            self._take(lane, freed, lane.largest(), EVICTION_FACTOR * own_bytes, self._wanted_bytes)
        if account.is_of_visit:
            least_bytes, most_bytes = own_bytes // (EVICTION_FACTOR if is_first else 1), self._wanted_bytes
        else:
            spare_bytes = sum(lane.size_of_visits_bytes for lane in self._lanes) - EVICTION_FACTOR * own_bytes
            least_bytes, most_bytes = 1, min(self._wanted_bytes, spare_bytes)
        for lane, freed in zip(self._lanes, self._freed, strict=True):
            self._take(lane, freed, lane.largest(of_visits=True), max(1, least_bytes), most_bytes, but=account.name)
        if self._freed_bytes < self._wanted_bytes:
            raise BlockRobotError("MEMPOOL_FULL")
        return self._txids

    def _take(
        self,
        lane: Lane[W],
        freed: Counter[str],
        accounts: Iterator[str],
        least_bytes: int,
        most_bytes: int,
        but: str = "",
    ) -> None:
        for account in accounts:
            if self._freed_bytes >= most_bytes:
                return
            if lane.size_of(account) < least_bytes:
                return  # the next ones have less, or hardly more: not all are looked at
            if account == but:
                continue
            for txid, item in reversed(lane.queues[account].items()):
                if self._freed_bytes >= most_bytes or lane.size_of(account) - freed[account] < least_bytes:
                    break
                if txid not in self._txids:
                    self._txids[txid] = None
                    self._freed_bytes += item.size_bytes
                    freed[account] += item.size_bytes
