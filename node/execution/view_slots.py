"""Limits on views waiting for the contract worker, per source and in total."""

from __future__ import annotations

from collections import Counter

from consensus.errors import BlockRobotError
from node.budgets.token_buckets import Source, over_budget

VIEWS_WAITING_MAX_COUNT = 64
VIEWS_OF_SOURCE_MAX_COUNT = 8
"""Of a session, of the visit keys at one address, or of this node itself."""
VIEWS_OF_VISIT_KEY_MAX_COUNT = 2


class ViewPlaces:
    """The views that run or wait."""

    def __init__(self) -> None:
        self._taken: Counter[Source] = Counter()
        self._count = 0

    def take(self, source: Source) -> None:
        """Take a place. Raises RATE_LIMITED for the source's share, VIEWS_BUSY for the total."""
        is_over_part = bool(source.part) and self._taken[source] >= VIEWS_OF_VISIT_KEY_MAX_COUNT
        if is_over_part or self._taken[source.shared] >= VIEWS_OF_SOURCE_MAX_COUNT:
            raise over_budget(str(source), 1.0)
        if self._count >= VIEWS_WAITING_MAX_COUNT:
            raise BlockRobotError("VIEWS_BUSY")
        self._add(source, 1)

    def give_back(self, source: Source) -> None:
        self._add(source, -1)

    def _add(self, source: Source, count: int) -> None:
        self._count += count
        for each in dict.fromkeys((source, source.shared)):
            self._taken[each] += count
            if not self._taken[each]:
                del self._taken[each]
