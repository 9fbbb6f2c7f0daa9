"""Meters requests' CPU time and charges it; debts cause refusals."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import Any, Generic, TypeVar

from node.api.access.request_rate_limiter import ChargedBudgets
from node.api.ports import LedgerReader
from node.limits.token_buckets import Source
from node.storage.ledger_view import LedgerView

HTTP_US = 250
"""What one request and its answer take besides its own slices: parsing, routing, writing."""
SLICE_US = 1_000
"""How long one slice of a reading takes at least, before the event loop and another source have their turn."""

T = TypeVar("T")
Steps = Generator[None, None, T]
"""Work that may pause wherever it yields, at least once in about a millisecond; what it returns is the result."""


class Meter:
    """What one request has cost so far, and what is paid."""

    def __init__(self) -> None:
        self._spent_us: float = HTTP_US
        self._paid_us = 0.0
        self._tab: ChargedBudgets | None = None
        self._is_stream = False

    def pay_by(self, tab: ChargedBudgets, prepaid_us: int) -> None:
        """Set who pays and what was prepaid; covers earlier spending too."""
        self._tab, self._paid_us = tab, float(prepaid_us)

    def add(self, spent_us: float) -> None:
        self._spent_us += spent_us
        if self._tab is not None and self._spent_us > self._paid_us:
            self._tab.charge(self._spent_us - self._paid_us)
            self._paid_us = self._spent_us

    def require(self) -> None:
        """Raise RATE_LIMITED for a source in debt, unless its answer has begun."""
        if self._tab is not None and not self._is_stream:
            self._tab.require()

    async def pace(self) -> None:
        self._is_stream = True
        if self._tab is not None:
            while (wait_s := self._tab.debt_s()) > 0:
                self._tab.note()
                await asyncio.sleep(wait_s)


class Metered(Generic[T]):
    """Awaits a coroutine and meters the CPU time of each of its slices."""

    def __init__(self, work: Coroutine[Any, Any, T], meter: Meter) -> None:
        self._work, self._meter = work, meter

    def __await__(self) -> Generator[Any, Any, T]:
        sent: Any = None
        thrown: BaseException | None = None
        while True:
            started_ns = time.thread_time_ns()
            try:
                waits_for = self._work.send(sent) if thrown is None else self._work.throw(thrown)
            except StopIteration as end:
                result: T = end.value
                return result
            finally:
                self._meter.add((time.thread_time_ns() - started_ns) / 1_000)
            try:
                sent, thrown = (yield waits_for), None
            except BaseException as error:  # noqa: BLE001 - handed on to the work: cancellation too
                thrown = error


class _Reading(Generic[T]):
    """One piece of work on a snapshot, run in the readers' thread."""

    def __init__(self, ledger: LedgerReader, work: Callable[[LedgerView], Steps[T]]) -> None:
        self._steps = self._run(ledger, work)
        self.spent_us = 0.0

    @staticmethod
    def _run(ledger: LedgerReader, work: Callable[[LedgerView], Steps[T]]) -> Steps[T]:
        with ledger.snapshot() as snapshot:
            return (yield from work(snapshot))

    def go_on(self) -> tuple[T] | None:
        started_ns = time.thread_time_ns()
        try:
            while time.thread_time_ns() - started_ns < SLICE_US * 1_000:
                next(self._steps)
        except StopIteration as end:
            return (end.value,)
        finally:
            self.spent_us = (time.thread_time_ns() - started_ns) / 1_000
        return None

    def close(self) -> None:
        self._steps.close()


class Readings:
    """Reads the ledger in slices, one request per source, half of the time at most."""

    def __init__(self, ledger: LedgerReader) -> None:
        self._ledger = ledger
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="reading")
        self._turns: dict[Source, tuple[asyncio.Lock, list[None]]] = {}
        self._one = asyncio.Lock()
        self._rested_s = 0.0

    def stop(self) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)

    async def read(self, source: Source, meter: Meter, work: Callable[[LedgerView], Steps[T]]) -> T:
        """Run work on the newest finalized snapshot. Raises RATE_LIMITED in debt, and as `work`."""
        async with self._turn(source), self._one:
            meter.require()
            reading = _Reading(self._ledger, work)
            loop = asyncio.get_running_loop()
            try:
                found = None
                while found is None:
                    await asyncio.sleep(max(0.0, self._rested_s - loop.time()))
                    reading.spent_us = 0.0
                    try:
                        found = await loop.run_in_executor(self._thread, reading.go_on)
                    finally:
                        meter.add(reading.spent_us)
                        self._rested_s = loop.time() + reading.spent_us / 1_000_000
            except BaseException:
                self._close(reading)
                raise
            return found[0]

    def _close(self, reading: _Reading[T]) -> None:
        try:
            self._thread.submit(reading.close)
        except RuntimeError:  # the thread is stopped, so nothing is in work
            reading.close()

    @asynccontextmanager
    async def _turn(self, source: Source) -> AsyncIterator[None]:
        lock, users = self._turns.setdefault(source, (asyncio.Lock(), []))
        users.append(None)
        try:
            async with lock:
                yield
        finally:
            users.pop()
            if not users:
                del self._turns[source]
