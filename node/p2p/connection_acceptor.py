"""Accepts connections until their TLS handshake ends, limited by address."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from consensus.errors import BlockRobotError
from node.limits.token_buckets import Allowance, Source, TokenBuckets, source_at
from pages.listening import ByAddress, accept_each, open_listener, share_of_descriptors

HANDSHAKE_TIMEOUT_MS = 5_000
SHUTDOWN_TIMEOUT_MS = 1_000
"""For how long a closed connection may wait for the other side to confirm."""
HANDSHAKE_US = 3_000


OF_ADDRESS_PART = 4
"""An address may have a quarter of the places."""
KNOWN_PART = 2
"""Half of them are for addresses that are known, and the others have no more than the rest."""


@dataclass(frozen=True, slots=True)
class HandshakeLimits:
    """How many handshakes may be open, and how much time those of an address may take.

    Of a node's descriptors they take one in `descriptors_part` at most.
    """

    open_max_count: int
    descriptors_part: int
    allowance: Allowance


OF_PEERS = HandshakeLimits(64, 16, Allowance(us_per_s=20 * HANDSHAKE_US, burst_us=60 * HANDSHAKE_US))
"""Twenty handshakes a second of an address."""
OF_CLIENTS = HandshakeLimits(256, 32, Allowance(us_per_s=40 * HANDSHAKE_US, burst_us=200 * HANDSHAKE_US))
"""Forty: the wallets of a ward may share an address."""


class _Places:
    """The handshakes of the addresses that share a number of places."""

    def __init__(self, max_count: int, of_address_max_count: int) -> None:
        self._max_count = max_count
        self._of_address_max_count = of_address_max_count
        self._open: ByAddress[Source, asyncio.Task[None]] = ByAddress()

    def add(self, source: Source, handshake: asyncio.Task[None]) -> bool:
        """End another for which there is no place any more; return False if this source has all that it may."""
        handshake.add_done_callback(partial(self._open.remove, source))
        self._open.add(source, handshake)
        is_within = self._open.count_of(source) <= self._of_address_max_count
        if not is_within:
            self._open.pop_oldest(source).cancel()
        elif len(self._open) > self._max_count:
            self._open.pop_oldest().cancel()
        return is_within


class ConnectionAcceptor:
    """The connections whose handshakes are open; where places are short, whoever has most of them loses the oldest."""

    def __init__(
        self,
        context: Callable[[], ssl.SSLContext],
        on_over_budget: Callable[[Source, float], None],
        limits: HandshakeLimits,
        known: Callable[[], Collection[Source]] | None = None,
    ) -> None:
        """`on_over_budget` gets addresses with too many handshakes; those that are `known` have places of their own."""
        self._context = context
        self._on_over_budget = on_over_budget
        self._budgets: TokenBuckets[Source] = TokenBuckets(lambda _source: limits.allowance, time.monotonic)
        max_count = share_of_descriptors(limits.open_max_count, limits.descriptors_part)
        of_address_max_count = max(1, max_count // OF_ADDRESS_PART)
        known_max_count = 0 if known is None else max_count // KNOWN_PART
        self._known = known or frozenset[Source]
        self._of_known = _Places(known_max_count, of_address_max_count)
        self._of_strangers = _Places(max_count - known_max_count, of_address_max_count)
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self, listener: socket.socket, make: Callable[[], asyncio.Protocol]) -> None:
        """Accept until cancelled; `make` builds a connection's protocol."""
        try:
            await accept_each(listener, partial(self.accept, make))
        finally:
            self.close()

    def close(self) -> None:
        """End all handshakes that are open."""
        for task in self._tasks:
            task.cancel()

    async def accept(self, make: Callable[[], asyncio.Protocol], accepted: socket.socket, host: str) -> None:
        """Begin a handshake, or close a connection whose address has no budget left."""
        source = source_at(host)
        if not self._budgets.take(source, HANDSHAKE_US):
            self._on_over_budget(source, self._budgets.wait_s(source, HANDSHAKE_US))
            accepted.close()
            return
        task = asyncio.get_running_loop().create_task(self._shake_hands(make, accepted))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        places = self._of_known if source in self._known() else self._of_strangers
        if not places.add(source, task):
            self._on_over_budget(source, 0.0)

    async def _shake_hands(self, make: Callable[[], asyncio.Protocol], accepted: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                make,
                accepted,
                ssl=self._context(),
                ssl_handshake_timeout=HANDSHAKE_TIMEOUT_MS / 1000,
                ssl_shutdown_timeout=SHUTDOWN_TIMEOUT_MS / 1000,
            )
        except (OSError, TimeoutError):
            accepted.close()


def bind_listener(host: str, port: int) -> socket.socket:
    """Raises PORT_IN_USE, PORT_NOT_PERMITTED, ADDRESS_NOT_HERE."""
    try:
        return open_listener(host, port)
    except OSError as error:
        place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        if isinstance(error, socket.gaierror) or error.errno in {errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT}:
            raise BlockRobotError("ADDRESS_NOT_HERE", f"{host} is no address of this machine.") from None
        if error.errno in {errno.EACCES, errno.EPERM}:
            raise BlockRobotError("PORT_NOT_PERMITTED", f"This user may not listen on {place}.") from None
        if error.errno != errno.EADDRINUSE:
            raise
        raise BlockRobotError("PORT_IN_USE", f"Another program already listens on {place}.") from None
