"""Looks host names up in threads of their own: a name whose servers are mute holds up nobody else, nor the program's end.

The event loops' own lookups share a few threads, keep what was cancelled in their queue, and are awaited at the end.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from aiohttp.abc import AbstractResolver, ResolveResult

from pages.listening import share_of_descriptors

LOOKUPS_MAX_COUNT = 128
"""Under way at once: twice as many as a network has nodes."""
_DESCRIPTORS_PART = 8
OWNERS_MAX_COUNT = 1024
SLOW_AFTER_MS = 1_000
"""Who has an older address waits no longer; names that took longer last time get half of the lookups at most."""
REST_FACTOR = 3
"""A name is asked for again after so many times what its last lookup took."""
REST_MAX_MS = 60_000
ADDRESSES_MAX_COUNT = 16
"""Of a name: its servers may answer with thousands."""


def look_up(host: str) -> list[str]:
    """Return the numeric addresses, with the scope of those that need one. Raises OSError, ValueError."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_ADDRCONFIG)
    return [socket.getnameinfo(place[4], socket.NI_NUMERICHOST)[0] for place in found[:ADDRESSES_MAX_COUNT]]


@dataclass(slots=True)
class _Name:
    host: str
    addresses: list[str]
    is_slow: bool = False
    begun_s: float = 0.0
    rest_until_s: float = 0.0
    ended: asyncio.Event | None = None
    """While a lookup is under way."""


class NameLookups(AbstractResolver):
    """The lookups of one event loop, and aiohttp's resolver."""

    def __init__(self, look: Callable[[str], list[str]] = look_up, clock: Callable[[], float] = time.monotonic) -> None:
        self._look, self._clock = look, clock
        self._max_count = share_of_descriptors(LOOKUPS_MAX_COUNT, _DESCRIPTORS_PART)
        self._names: dict[Hashable, _Name] = {}
        self.under_way_count = 0

    async def find(self, host: str, owner: Hashable = None) -> list[str]:
        """Return numeric addresses, the former ones where there is no answer. Raises OSError.

        An owner (else the name) has one lookup under way at most, also when its name changes.
        """
        with contextlib.suppress(ValueError):
            return [str(ipaddress.ip_address(host))]
        owner = host if owner is None else owner
        while (name := self._name_of(owner, host)).host != host and name.ended is not None:
            await name.ended.wait()
        if name.ended is None and self._clock() >= name.rest_until_s:
            self._begin(name)
        if name.ended is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(SLOW_AFTER_MS / 1000 if name.addresses else None):
                    await name.ended.wait()
        if not name.addresses:
            raise socket.gaierror(socket.EAI_AGAIN, "no address was found for this name")
        return name.addresses

    def _name_of(self, owner: Hashable, host: str) -> _Name:
        name = self._names.pop(owner, None)
        if name is None or (name.host != host and name.ended is None):
            name = _Name(host, [])
        self._names[owner] = name
        while len(self._names) > OWNERS_MAX_COUNT:
            del self._names[next(iter(self._names))]
        return name

    def _begin(self, name: _Name) -> None:
        if self.under_way_count >= (self._max_count // 2 if name.is_slow else self._max_count):
            return
        loop = asyncio.get_running_loop()
        thread = threading.Thread(target=self._run, args=(name, loop), name=f"lookup {name.host}", daemon=True)
        name.begun_s = self._clock()
        try:
            thread.start()
        except RuntimeError:  # the system grants no more threads
            return
        name.ended = asyncio.Event()
        self.under_way_count += 1

    def _run(self, name: _Name, loop: asyncio.AbstractEventLoop) -> None:
        found: list[str] = []
        try:
            found = self._look(name.host)
        except (OSError, ValueError):  # the latter: a name that IDNA refuses
            pass
        finally:
            took_s = self._clock() - name.begun_s  # here, since the loop may be busy
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(self._end, name, found, took_s)

    def _end(self, name: _Name, found: list[str], took_s: float) -> None:
        name.is_slow = took_s * 1000 >= SLOW_AFTER_MS
        name.rest_until_s = self._clock() + min(took_s * REST_FACTOR, REST_MAX_MS / 1000)
        name.addresses = found or name.addresses
        self.under_way_count -= 1
        if name.ended is not None:
            name.ended.set()
        name.ended = None

    async def resolve(
        self, host: str, port: int = 0, family: socket.AddressFamily = socket.AF_INET
    ) -> list[ResolveResult]:
        """Raises OSError."""
        wanted = {4: socket.AF_INET, 6: socket.AF_INET6}
        found = [(wanted[ipaddress.ip_address(item).version], item) for item in await self.find(host)]
        flags = socket.AI_NUMERICHOST | socket.AI_NUMERICSERV
        return [
            ResolveResult(hostname=host, host=item, port=port, family=kind, proto=0, flags=flags)
            for kind, item in found
            if family in {kind, socket.AF_UNSPEC}
        ]

    async def close(self) -> None:
        """Nothing to close: lookups under way end by themselves."""
