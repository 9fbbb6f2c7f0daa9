"""Pools companion suspicion over time; recent two-person silhouettes are never cleared."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from clients.robot.hiding.companion import Trees, shipped_model
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.withhold_reason import MergedBy

SAME_M, SAME_PER_M = 0.45, 0.04
FORGET_AFTER_MS = 1_000
POOL_MS = 700.0
SETTLED_MS = 500
LOG_ODDS_LIMIT = 8.0
CLEAR_BELOW = 1.5  # log-odds under the threshold at which a pool that was over it is clear again


@dataclass(slots=True, eq=False)
class _Pool:
    x_m: float
    z_m: float
    began_ms: int
    seen_ms: int
    odds: float
    two: bool


class CompanionWatch:
    """Follows silhouettes by nearest place and averages their log-odds over about 0.7 s. `merged`: pooled to two;
    `contact`: two in this frame only, withheld on the same track. One per camera; not thread-safe.
    """

    def __init__(self, model: Trees | None = None) -> None:
        self._model = model or shipped_model()
        self._pools: list[_Pool] = []

    def step(self, silhouettes: tuple[Silhouette, ...], at_ms: int) -> tuple[Silhouette, ...]:
        """Call in time order."""
        self._pools = [pool for pool in self._pools if at_ms - pool.seen_ms <= FORGET_AFTER_MS]
        free = list(self._pools)
        return tuple(self._judge(silhouette, free, at_ms) for silhouette in silhouettes)

    def _judge(self, silhouette: Silhouette, free: list[_Pool], at_ms: int) -> Silhouette:
        pool = self._pool_of(silhouette, free, at_ms)
        if pool.two:
            return silhouette if silhouette.withhold_reason == "merged" else _merged_by_pool(silhouette)
        settled = at_ms - pool.began_ms >= SETTLED_MS
        if silhouette.withhold_reason == "merged" and settled and silhouette.companion_odds <= self._model.certain:
            return replace(silhouette, withhold_reason="contact")
        return silhouette

    def _pool_of(self, silhouette: Silhouette, free: list[_Pool], at_ms: int) -> _Pool:
        odds = max(-LOG_ODDS_LIMIT, min(LOG_ODDS_LIMIT, silhouette.companion_odds))
        near = [(math.hypot(pool.x_m - silhouette.x_m, pool.z_m - silhouette.z_m), i) for i, pool in enumerate(free)]
        distance, place = min(near, default=(math.inf, -1))
        if distance > SAME_M + SAME_PER_M * silhouette.z_m:
            pool = _Pool(silhouette.x_m, silhouette.z_m, at_ms, at_ms, odds, odds > self._model.suspect)
            self._pools.append(pool)
            return pool
        pool = free.pop(place)
        weight = 1 - math.exp(-max(at_ms - pool.seen_ms, 1) / POOL_MS)
        pool.odds += weight * (odds - pool.odds)
        pool.x_m, pool.z_m, pool.seen_ms = silhouette.x_m, silhouette.z_m, at_ms
        pool.two = pool.odds > self._model.suspect - (CLEAR_BELOW if pool.two else 0.0)
        return pool


def _merged_by_pool(silhouette: Silhouette) -> Silhouette:
    company = silhouette.company
    earlier = None if company is None else replace(company, by=MergedBy.BEFORE)
    return replace(silhouette, withhold_reason="merged", company=earlier)
