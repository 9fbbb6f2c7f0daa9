"""Token buckets in microseconds of work, one per source; work is prepaid."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from consensus.errors import BlockRobotError
from pages.listening import network_of, plain_address

SOURCES_MAX_COUNT = 4096
RETRY_AFTER_MAX_S = 60
_ROUNDING_US = 1.0

K = TypeVar("K", bound=Hashable)


SourceKind = Literal["own", "peer", "address", "loopback", "session", "visit_keys"]
_SHOWN: dict[SourceKind, str] = {"visit_keys": "visit keys at"}


@dataclass(frozen=True, slots=True)
class Source:
    """Origin of transactions: this node, a peer, an address or a session key; `part` distinguishes sharers."""

    kind: SourceKind
    name: str = ""
    part: str = ""

    def __str__(self) -> str:
        return f"{_SHOWN.get(self.kind, self.kind)} {self.name}".strip()

    @property
    def shared(self) -> Source:
        return Source(self.kind, self.name) if self.part else self


OWN = Source("own")


def source_at(address: str) -> Source:
    """Addresses of IPv6 count by network."""
    try:
        kind: SourceKind = "loopback" if plain_address(address).is_loopback else "address"
    except ValueError:
        kind = "address"
    return Source(kind, network_of(address))


@dataclass(frozen=True, slots=True)
class Allowance:
    """How much work a source may cause: steady rate and burst."""

    us_per_s: int
    burst_us: int


@dataclass(slots=True)
class TokenBucket:
    """One source's budget; a negative level is debt paid off over time."""

    allowance: Allowance
    level_us: float
    seen_s: float

    def _fill(self, now_s: float) -> None:
        gained_us = max(0.0, now_s - self.seen_s) * self.allowance.us_per_s
        self.level_us = min(float(self.allowance.burst_us), self.level_us + gained_us)
        self.seen_s = max(self.seen_s, now_s)

    def take(self, cost_us: float, now_s: float) -> bool:
        self._fill(now_s)
        if self.level_us + _ROUNDING_US < cost_us:
            return False
        self.level_us -= cost_us
        return True

    def charge(self, cost_us: float, now_s: float, debt_max_us: float = math.inf) -> None:
        self._fill(now_s)
        self.level_us = max(self.level_us - cost_us, min(self.level_us, -debt_max_us))

    def wait_s(self, cost_us: float, now_s: float) -> float:
        """Return seconds until this cost, or at most a full bucket, is there."""
        self._fill(now_s)
        missing_us = min(cost_us, float(self.allowance.burst_us)) - self.level_us
        return max(0.0, missing_us / self.allowance.us_per_s)


@dataclass(slots=True)
class Charge:
    """A bucket's payment; refunds go to that bucket, up to its amount."""

    bucket: TokenBucket
    paid_us: float

    def give_back(self, cost_us: float = math.inf) -> None:
        given_us = min(cost_us, self.paid_us)
        self.paid_us -= given_us
        self.bucket.level_us = min(float(self.bucket.allowance.burst_us), self.bucket.level_us + given_us)


class TokenBuckets(Generic[K]):
    """The buckets of one kind of sources; the least recently seen are evicted."""

    def __init__(
        self, allowance: Callable[[K], Allowance], clock_s: Callable[[], float], max_count: int = SOURCES_MAX_COUNT
    ) -> None:
        """`clock_s` gives monotonic seconds."""
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

    def take(self, source: K, cost_us: float) -> Charge | None:
        bucket, now_s = self._of(source)
        return Charge(bucket, cost_us) if bucket.take(cost_us, now_s) else None

    def charge(self, source: K, cost_us: float, debt_max_us: float = math.inf) -> None:
        """Take it even where it is not there; the debt grows to `debt_max_us` at most."""
        bucket, now_s = self._of(source)
        bucket.charge(cost_us, now_s, debt_max_us)

    def wait_s(self, source: K, cost_us: float = 1.0) -> float:
        bucket, now_s = self._of(source)
        return bucket.wait_s(cost_us, now_s)


def over_budget(who: str, wait_s: float) -> BlockRobotError:
    retry_after_s = max(1, min(RETRY_AFTER_MAX_S, round(wait_s + 0.5)))
    return BlockRobotError(
        "RATE_LIMITED", f"The budget of {who} is used up for {retry_after_s} s.", retry_after_s=retry_after_s
    )
