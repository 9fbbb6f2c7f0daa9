"""Token buckets in microseconds of work, one for each source of work.

A source (a peer, a client's address, a member's key) has a bucket that fills at a steady rate. Work is paid for before it
is done, by the prices of `node/budgets/work_costs.py`; whoever has nothing left waits, or is refused and told for how long.
"""

from __future__ import annotations

import ipaddress
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from consensus.errors import BlockRobotError

SOURCES_MAX_COUNT = 4096
RETRY_AFTER_MAX_S = 60
_ROUNDING_US = 1.0

K = TypeVar("K", bound=Hashable)


SourceKind = Literal["own", "peer", "address", "loopback", "session", "visit_keys"]
_SHOWN: dict[SourceKind, str] = {"visit_keys": "visit keys at"}


@dataclass(frozen=True, slots=True)
class Source:
    """Who brings transactions: this node, a peer, a client's address, or the key of a client's session.

    Those who share one source, as the keys of visits at one address do, are told apart by `part`.
    """

    kind: SourceKind
    name: str = ""
    part: str = ""

    def __str__(self) -> str:
        return f"{_SHOWN.get(self.kind, self.kind)} {self.name}".strip()

    @property
    def shared(self) -> Source:
        """The source that all its parts share."""
        return Source(self.kind, self.name) if self.part else self


OWN = Source("own")


def source_at(address: str) -> Source:
    """Return who is at an address, as long as nothing more is known of him."""
    try:
        is_loopback = ipaddress.ip_address(address).is_loopback
    except ValueError:
        is_loopback = False
    return Source("loopback" if is_loopback else "address", address)


@dataclass(frozen=True, slots=True)
class Allowance:
    """How much work a source may cause: steadily, and at once after it was quiet."""

    us_per_s: int
    burst_us: int


@dataclass(slots=True)
class TokenBucket:
    """One source's budget. The level may be negative: a debt that time pays off."""

    allowance: Allowance
    level_us: float
    seen_s: float

    def _fill(self, now_s: float) -> None:
        gained_us = max(0.0, now_s - self.seen_s) * self.allowance.us_per_s
        self.level_us = min(float(self.allowance.burst_us), self.level_us + gained_us)
        self.seen_s = max(self.seen_s, now_s)

    def take(self, cost_us: float, now_s: float) -> bool:
        """Pay if there is enough; tell whether there was."""
        self._fill(now_s)
        if self.level_us + _ROUNDING_US < cost_us:
            return False
        self.level_us -= cost_us
        return True

    def charge(self, cost_us: float, now_s: float) -> None:
        """Pay in any case, by a debt if need be."""
        self._fill(now_s)
        self.level_us -= cost_us

    def wait_s(self, cost_us: float, now_s: float) -> float:
        """Return how long it is until there is enough for this cost, or for a full bucket if it costs more than that."""
        self._fill(now_s)
        missing_us = min(cost_us, float(self.allowance.burst_us)) - self.level_us
        return max(0.0, missing_us / self.allowance.us_per_s)


@dataclass(slots=True)
class Receipt:
    """What one bucket paid. It goes back to that bucket only, and never more than was paid."""

    bucket: TokenBucket
    paid_us: float

    def give_back(self, cost_us: float = math.inf) -> None:
        """Give back so much of it, or all: somebody else pays for the work, or it was not done."""
        given_us = min(cost_us, self.paid_us)
        self.paid_us -= given_us
        self.bucket.level_us = min(float(self.bucket.allowance.burst_us), self.bucket.level_us + given_us)


class Budgets(Generic[K]):
    """The buckets of all sources of one kind; the least recently seen make room."""

    def __init__(
        self, allowance: Callable[[K], Allowance], clock_s: Callable[[], float], max_count: int = SOURCES_MAX_COUNT
    ) -> None:
        """`clock_s` gives seconds that only grow."""
        self._allowance = allowance
        self._clock_s = clock_s
        self._max_count = max_count
        self._buckets: OrderedDict[K, TokenBucket] = OrderedDict()

    def __len__(self) -> int:
        return len(self._buckets)

    def _of(self, source: K) -> tuple[TokenBucket, float]:
        now_s, allowance = self._clock_s(), self._allowance(source)
        bucket = self._buckets.get(source)
        if bucket is None:
            bucket = self._buckets[source] = TokenBucket(allowance, allowance.burst_us, now_s)
            if len(self._buckets) > self._max_count:
                self._buckets.popitem(last=False)
        else:
            bucket.allowance = allowance
            self._buckets.move_to_end(source)
        return bucket, now_s

    def take(self, source: K, cost_us: float) -> Receipt | None:
        """Pay if the source has enough; return the receipt, or None if it has not."""
        bucket, now_s = self._of(source)
        return Receipt(bucket, cost_us) if bucket.take(cost_us, now_s) else None

    def charge(self, source: K, cost_us: float) -> None:
        """Let the source pay in any case."""
        bucket, now_s = self._of(source)
        bucket.charge(cost_us, now_s)

    def wait_s(self, source: K, cost_us: float = 1.0) -> float:
        """Return how long it is until the source can pay this."""
        bucket, now_s = self._of(source)
        return bucket.wait_s(cost_us, now_s)


def over_budget(who: str, wait_s: float) -> BlockRobotError:
    """Return the refusal of somebody who has nothing left, with the time after which to try again."""
    retry_after_s = max(1, min(RETRY_AFTER_MAX_S, round(wait_s + 0.5)))
    return BlockRobotError(
        "RATE_LIMITED", f"The budget of {who} is used up for {retry_after_s} s.", retry_after_s=retry_after_s
    )
