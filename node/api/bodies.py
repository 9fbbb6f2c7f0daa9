"""Limits the request-body bytes a node holds, per source and in all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from consensus.errors import BlockRobotError
from consensus.limits import MIB_BYTES
from node.limits.token_buckets import Source, over_budget

BODIES_MAX_BYTES = 256 * MIB_BYTES
BODIES_OF_SOURCE_MAX_BYTES = 64 * MIB_BYTES
"""Of a session, of the visit keys at one address, or of this machine: a robot brings a few clips at a time."""
BODIES_OF_VISIT_KEY_MAX_BYTES = 2 * MIB_BYTES
"""Of each of the visit keys at one address: it takes 32 of them to fill what they share."""
BODIES_OF_ADDRESS_MAX_BYTES = 8 * MIB_BYTES
"""Of all who show no session at one address of another machine."""

Hold = Callable[[int], None]
"""Takes room for so many bytes more. Raises RATE_LIMITED if there is none."""


class Bodies:
    """Bodies of all open requests, complete or not."""

    def __init__(self, on_over_budget: Callable[[str, BlockRobotError], None]) -> None:
        self._on_over_budget = on_over_budget
        self._held: Counter[Source] = Counter()
        self._total_bytes = 0

    @contextmanager
    def of(self, source: Source) -> Iterator[Hold]:
        most = BODIES_OF_ADDRESS_MAX_BYTES if source.kind == "address" else BODIES_OF_SOURCE_MAX_BYTES
        taken = 0

        def hold(count: int) -> None:
            nonlocal taken
            is_over_part = bool(source.part) and self._held[source] + count > BODIES_OF_VISIT_KEY_MAX_BYTES
            if is_over_part or self._held[source.shared] + count > most:
                error = over_budget(str(source), 1.0)
                self._on_over_budget(str(source), error)
                raise error
            if self._total_bytes + count > BODIES_MAX_BYTES:
                raise BlockRobotError(
                    "RATE_LIMITED", "The node holds as many bytes of requests as it may.", retry_after_s=1
                )
            self._take(source, count)
            taken += count

        try:
            yield hold
        finally:
            self._take(source, -taken)

    def _take(self, source: Source, count: int) -> None:
        self._total_bytes += count
        for each in dict.fromkeys((source, source.shared)):
            self._held[each] += count
            if not self._held[each]:
                del self._held[each]
