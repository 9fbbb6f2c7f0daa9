"""A token bucket per remote address, for callers without a session. Must never grow without bound.

Loopback has a generous bucket of its own: on an emulated network every client shares that one address.
"""

from __future__ import annotations

import ipaddress
from collections import OrderedDict

from consensus.errors import BlockRobotError
from node.api.services import Clock

REQUESTS_PER_SECOND = 20.0
REQUESTS_BURST_COUNT = 100.0
LOOPBACK_REQUESTS_PER_SECOND = 20_000.0
LOOPBACK_BURST_COUNT = 40_000.0
ADDRESSES_MAX_COUNT = 4096


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


class RateLimiter:
    """Buckets by remote address; the least recently seen addresses make room."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def take(self, address: str) -> None:
        """Take one token of this address. Raises RATE_LIMITED if there is none."""
        rate, burst = (
            (LOOPBACK_REQUESTS_PER_SECOND, LOOPBACK_BURST_COUNT)
            if _is_loopback(address)
            else (REQUESTS_PER_SECOND, REQUESTS_BURST_COUNT)
        )
        now_ms = self._clock.now_ms()
        level, seen_ms = self._buckets.pop(address, (burst, now_ms))
        level = min(burst, level + max(0, now_ms - seen_ms) * rate / 1000)
        allowed = level >= 1
        self._buckets[address] = (level - 1 if allowed else level, now_ms)
        while len(self._buckets) > ADDRESSES_MAX_COUNT:
            self._buckets.popitem(last=False)
        if not allowed:
            raise BlockRobotError("RATE_LIMITED")
