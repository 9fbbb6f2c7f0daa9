"""Token buckets for transaction bytes per account; each node counts every waiting transaction."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

from contracts.execution.sender_admission import Account
from node.limits.token_buckets import over_budget

ACCOUNT_BYTES_PER_S = 2 * 1024
"""About 180 MB a day, two records a second day and night; 65 GB in the year that blocks stay."""
ACCOUNT_BURST_BYTES = 256 * 1024 * 1024
ACCOUNTS_MAX_COUNT = 65_536
VISITS_PART = 64
"""A visit has so small a part of an account's budget, and pays from that of all visits which its robot opened, too: one
person has many, and a robot that lies opens as many as it likes."""


class AccountByteLimiter:
    """Buckets of all accounts that are not full; evicts the least recently seen."""

    def __init__(
        self,
        clock_s: Callable[[], float] = time.monotonic,
        *,
        bytes_per_s: int = ACCOUNT_BYTES_PER_S,
        burst_bytes: int = ACCOUNT_BURST_BYTES,
    ) -> None:
        """`clock_s` is monotonic, in seconds."""
        self._clock_s = clock_s
        self._bytes_per_s = bytes_per_s
        self._burst_bytes = burst_bytes
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def level(self, name: str, part: int = 1) -> float:
        """Return bytes left under a name with 1/`part` of an account's bucket."""
        now_s, burst_bytes = self._clock_s(), self._burst_bytes / part
        level, seen_s = self._buckets.get(name, (burst_bytes, now_s))
        return min(burst_bytes, level + (now_s - seen_s) * self._bytes_per_s / part)

    def take(self, account: Account, size_bytes: int) -> None:
        """Raises RATE_LIMITED with the time to wait."""
        for name, part in _budgets_of(account):
            missing_bytes = size_bytes - self.level(name, part)
            if missing_bytes > 0:
                raise over_budget("this account's bytes", missing_bytes * part / self._bytes_per_s)
        for name, part in _budgets_of(account):
            self._set(name, self.level(name, part) - size_bytes)

    def refund(self, account: Account, size_bytes: int) -> None:
        for name, part in _budgets_of(account):
            if name in self._buckets:
                self._set(name, min(self._burst_bytes / part, self.level(name, part) + size_bytes))

    def _set(self, name: str, level: float) -> None:
        self._buckets[name] = level, self._clock_s()
        self._buckets.move_to_end(name)
        if len(self._buckets) > ACCOUNTS_MAX_COUNT:
            self._buckets.popitem(last=False)


def _budgets_of(account: Account) -> list[tuple[str, int]]:
    """Return (bucket name, divisor) pairs that an account pays from."""
    if not account.origin:
        return [(account.name, 1)]
    return [(account.name, VISITS_PART), (account.origin, 1)]
