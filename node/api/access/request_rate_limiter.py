"""Rate limits of client requests, by session key or else by address.

Visits' keys at one address share a budget, with a small reserve each, to keep erasure possible during a flood.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from node.api.access.sessions import Session
from node.limits.token_buckets import Allowance, Source, TokenBuckets, over_budget, source_at
from node.limits.work_costs import ROUTE_DEFAULT_US

ADDRESS_ALLOWANCE = Allowance(us_per_s=40 * ROUTE_DEFAULT_US, burst_us=200 * ROUTE_DEFAULT_US)
"""A page of a public explorer takes about 2 ms a second, and 30 ms when it is opened."""
LOOPBACK_ALLOWANCE = Allowance(us_per_s=160 * ROUTE_DEFAULT_US, burst_us=1_600 * ROUTE_DEFAULT_US)
SESSION_ALLOWANCE = Allowance(us_per_s=120 * ROUTE_DEFAULT_US, burst_us=400 * ROUTE_DEFAULT_US)
VISIT_KEYS_ALLOWANCE = Allowance(us_per_s=1_600 * ROUTE_DEFAULT_US, burst_us=16_000 * ROUTE_DEFAULT_US)
"""Of the keys of all visits at one address together."""
VISIT_KEY_ALLOWANCE = Allowance(us_per_s=2 * ROUTE_DEFAULT_US, burst_us=40 * ROUTE_DEFAULT_US)
"""What each of them may ask when the others have used that up."""
VISIT_KEYS_RESERVE = Allowance(us_per_s=400 * ROUTE_DEFAULT_US, burst_us=4_000 * ROUTE_DEFAULT_US)
"""How much that may come to at one address: 200 visits have to ask all they may until one is refused that asks little."""
SOURCES_MAX_COUNT = 4096
OnOverBudget = Callable[[str, BlockRobotError], None]
TURN_MAX_US = 2_000
REFUSAL_DELAY_S = 0.5
REFUSALS_DELAYED_MAX_COUNT = 512
WAITING_OF_SOURCE_MAX_COUNT = 256
WAITING_MAX_COUNT = 2048


def source_of(address: str | None, session: Session | None) -> Source:
    if session is None:
        return source_at(address or "unknown")
    if session.kind == "member":
        return Source("session", session.public_key.hex())
    return Source("visit_keys", source_at(address or "unknown").name, session.public_key.hex())


def _allowance_of(source: Source) -> Allowance:
    if source.kind == "session":
        return SESSION_ALLOWANCE
    if source.kind == "visit_keys":
        return VISIT_KEYS_ALLOWANCE
    return LOOPBACK_ALLOWANCE if source.kind == "loopback" else ADDRESS_ALLOWANCE


@dataclass(frozen=True, slots=True)
class ChargedBudgets:
    """Who pays for one request, and from which budgets."""

    source: Source
    budgets: tuple[tuple[TokenBuckets[Source], Source], ...]
    on_over_budget: OnOverBudget

    def charge(self, cost_us: float) -> None:
        for budgets, payer in self.budgets:
            budgets.charge(payer, cost_us)

    def debt_s(self) -> float:
        return max(budgets.wait_s(payer, 0.0) for budgets, payer in self.budgets)

    def note(self) -> BlockRobotError:
        error = over_budget(str(self.source), self.debt_s())
        self.on_over_budget(str(self.source), error)
        return error

    def require(self) -> None:
        """Raises RATE_LIMITED."""
        if self.debt_s() > 0:
            raise self.note()


class RequestRateLimiter:
    """The budgets of all sources; the least recently seen are evicted."""

    def __init__(self, on_over_budget: OnOverBudget, clock_s: Callable[[], float] = time.monotonic) -> None:
        """`on_over_budget` gets sources over budget; `clock_s` is monotonic seconds."""
        self._on_over_budget = on_over_budget
        self._budgets = TokenBuckets(_allowance_of, clock_s, SOURCES_MAX_COUNT)
        self._parts: TokenBuckets[Source] = TokenBuckets(lambda _part: VISIT_KEY_ALLOWANCE, clock_s, SOURCES_MAX_COUNT)
        self._reserves: TokenBuckets[Source] = TokenBuckets(
            lambda _shared: VISIT_KEYS_RESERVE, clock_s, SOURCES_MAX_COUNT
        )

    def __len__(self) -> int:
        return max(len(budgets) for budgets in (self._budgets, self._parts, self._reserves))

    def take(self, source: Source, cost_us: int = ROUTE_DEFAULT_US) -> ChargedBudgets:
        """Charge a source; return its tab. Raises RATE_LIMITED."""
        shared = source.shared
        if self._budgets.take(shared, cost_us):
            return ChargedBudgets(source, ((self._budgets, shared),), self._on_over_budget)
        if source.part and self._take_reserved(source, cost_us):
            return ChargedBudgets(source, ((self._parts, source), (self._reserves, shared)), self._on_over_budget)
        error = over_budget(str(source), self._budgets.wait_s(shared, cost_us))
        self._on_over_budget(str(source), error)
        raise error

    def _take_reserved(self, source: Source, cost_us: int) -> bool:
        charge = self._parts.take(source, cost_us)
        if charge is None or self._reserves.take(source.shared, cost_us):
            return charge is not None
        charge.give_back()
        return False


class FairQueue:
    """Starts requests round-robin by source, some milliseconds' worth per loop turn.

    Parts of one source share its turns; when full, whoever has most loses its newest.
    """

    def __init__(self, on_over_budget: OnOverBudget) -> None:
        self._on_over_budget = on_over_budget
        self._spent_us = 0
        self._waiting: OrderedDict[Source, OrderedDict[str, deque[tuple[int, asyncio.Future[None]]]]] = OrderedDict()
        self._counts: Counter[Source] = Counter()
        self._count = 0
        self._is_due = False

    async def wait(self, source: Source, cost_us: int) -> None:
        """Return when this request may begin. Raises RATE_LIMITED if too many wait."""
        if not self._waiting and self._spent_us < TURN_MAX_US:
            self._spend(cost_us)
            return
        shared = source.shared
        if self._counts[shared] >= WAITING_OF_SOURCE_MAX_COUNT or self._count >= WAITING_MAX_COUNT:
            self._make_place(source)
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(shared, OrderedDict()).setdefault(source.part, deque()).append((cost_us, future))
        self._counts[shared] += 1
        self._count += 1
        await future

    def _make_place(self, source: Source) -> None:
        """Refuse the newest of whoever has most waiting: of all, else of its own source's parts, else this one."""
        crowded = max(self._counts, key=self._counts.__getitem__)
        own_count = self._counts[source.shared]
        if own_count >= WAITING_OF_SOURCE_MAX_COUNT or self._counts[crowded] <= own_count + 1:
            crowded = source.shared
        parts = self._waiting.get(crowded, OrderedDict())
        greedy = max(parts, key=lambda part: len(parts[part]), default="")
        if crowded == source.shared and len(parts.get(greedy, ())) <= len(parts.get(source.part, ())) + 1:
            raise self._refusal(source)
        _, future = parts[greedy].pop()
        if not parts[greedy]:
            del parts[greedy]
        self._counts[crowded] -= 1
        self._count -= 1
        if not future.done():
            future.set_exception(self._refusal(Source(crowded.kind, crowded.name, greedy)))

    def _refusal(self, source: Source) -> BlockRobotError:
        error = over_budget(str(source), 1.0)
        self._on_over_budget(str(source), error)
        return error

    def _spend(self, cost_us: int) -> None:
        self._spent_us += cost_us
        if not self._is_due:
            self._is_due = True
            asyncio.get_running_loop().call_soon(self._next_turn)

    def _next_turn(self) -> None:
        self._is_due, self._spent_us = False, 0
        while self._waiting and self._spent_us < TURN_MAX_US:
            source, parts = next(iter(self._waiting.items()))
            part, queue = next(iter(parts.items()))
            cost_us, future = queue.popleft()
            self._counts[source] -= 1
            self._count -= 1
            parts.move_to_end(part)
            self._waiting.move_to_end(source)
            if not queue:
                del parts[part]
            if not parts:
                del self._waiting[source], self._counts[source]
            if not future.done():
                self._spend(cost_us)
                future.set_result(None)


class RefusalDelay:
    """Delays refusals to sources over budget, to slow their retries."""

    def __init__(self) -> None:
        self._count = 0

    async def wait(self) -> None:
        if self._count >= REFUSALS_DELAYED_MAX_COUNT:
            return
        self._count += 1
        try:
            await asyncio.sleep(REFUSAL_DELAY_S)
        finally:
            self._count -= 1


def is_over_budget(error: BlockRobotError) -> bool:
    return error.code == "RATE_LIMITED" and "retry_after_s" in error.context
