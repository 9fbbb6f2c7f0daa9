"""Two pieces of work on one custodian, of which each stops where the test says: before or after any call of the store."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from node.custody.blobs.blob_backed_store import BlobBackedStore
from node.custody.blobs.blob_store import BlobStore
from node.custody.stores.custody_store import CustodyStore
from tests.offchain.house import CustodianHarness

NEVER = 1 << 30


class CountedLock(asyncio.Lock):
    """A lock that tells how many wait for it."""

    def __init__(self, news: asyncio.Event) -> None:
        super().__init__()
        self.waiting = 0
        self._news = news

    async def acquire(self) -> Any:
        self.waiting += 1
        self._news.set()
        try:
            return await super().acquire()
        finally:
            self.waiting -= 1

    async def is_waited_for(self) -> None:
        while not self.waiting:
            self._news.clear()
            await self._news.wait()


class _Stop:
    """One piece of work, that goes on to a place among its calls of the store, and from there when it is told."""

    def __init__(self, place: int) -> None:
        self.place = place
        self.passed = 0
        self.is_there = False
        self.go_on = asyncio.Event()


class Interleaving:
    """Puts stops around every call of an open house's store, and of its store of blobs."""

    def __init__(self, house: CustodianHarness) -> None:
        self.house = house
        self._stops: dict[str, _Stop] = {}
        self._news = asyncio.Event()
        self._lock = CountedLock(self._news)
        house.custodian._writing = self._lock
        self._stop_around(house.store, CustodyStore)
        if isinstance(house.store, BlobBackedStore):
            self._stop_around(house.store._blobs, BlobStore)

    def _stop_around(self, store: object, protocol: type) -> None:
        for name, _ in inspect.getmembers(protocol, inspect.iscoroutinefunction):
            if not name.startswith("_"):
                setattr(store, name, self._stopping(getattr(store, name)))

    def _stopping(self, method: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
        async def call(*arguments: Any, **named: Any) -> Any:
            await self._pass()
            found = await method(*arguments, **named)
            await self._pass()
            return found

        return call

    async def _pass(self) -> None:
        task = asyncio.current_task()
        stop = self._stops.get("" if task is None else task.get_name())
        if stop is None:
            return
        stop.passed += 1
        if stop.passed == stop.place:
            stop.is_there = True
            self._news.set()
            await stop.go_on.wait()

    async def play(
        self, first: Coroutine[Any, Any, Any], stop_first: int, second: Coroutine[Any, Any, Any], stop_second: int
    ) -> tuple[asyncio.Task[Any], asyncio.Task[Any]]:
        """Run the first piece to its stop, the second to its own, the first to its end, the second to its end.

        Whoever waits for the other's lock lets the other go on. Returns both tasks, done.
        """
        self._stops = {"first": _Stop(stop_first), "second": _Stop(stop_second)}
        one = asyncio.create_task(first, name="first")
        await self._until_still(one, self._stops["first"])
        two = asyncio.create_task(second, name="second")
        await self._until_still(two, self._stops["second"])
        self._stops["first"].go_on.set()
        await self._until_still(one, _Stop(NEVER))
        self._stops["second"].go_on.set()
        await asyncio.wait({one, two})
        return one, two

    async def _until_still(self, work: asyncio.Task[Any], stop: _Stop) -> None:
        work.add_done_callback(lambda _: self._news.set())
        while not work.done() and not stop.is_there and not self._lock.waiting:
            self._news.clear()
            await self._news.wait()

    async def count(self, work: Coroutine[Any, Any, Any]) -> int:
        """Run one piece alone and return how many places it passes."""
        self._stops = {"first": _Stop(NEVER)}
        await asyncio.wait({asyncio.create_task(work, name="first")})
        return self._stops["first"].passed
