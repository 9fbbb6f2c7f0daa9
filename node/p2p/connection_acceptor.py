"""Accepts connections until their TLS handshake ends, limited by address."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from consensus.errors import BlockRobotError
from node.limits.token_buckets import Allowance, Source, TokenBuckets, source_at
from pages.listening import accept_each, open_listener, share_of_descriptors

HANDSHAKE_TIMEOUT_MS = 5_000
SHUTDOWN_TIMEOUT_MS = 1_000
"""For how long a closed connection may wait for the other side to confirm."""
HANDSHAKE_US = 3_000


@dataclass(frozen=True, slots=True)
class HandshakeLimits:
    """How many handshakes may be open, in all and of an address, and how much time those of an address may take.

    Of a node's descriptors they take one in `descriptors_part` at most.
    """

    open_max_count: int
    descriptors_part: int
    of_address_max_count: int
    allowance: Allowance


OF_PEERS = HandshakeLimits(64, 16, 32, Allowance(us_per_s=20 * HANDSHAKE_US, burst_us=60 * HANDSHAKE_US))
"""Twenty handshakes a second of an address."""
OF_CLIENTS = HandshakeLimits(256, 32, 64, Allowance(us_per_s=40 * HANDSHAKE_US, burst_us=200 * HANDSHAKE_US))
"""Forty: the wallets of a ward may share an address."""


class ConnectionAcceptor:
    """The connections whose handshakes are open."""

    def __init__(
        self,
        context: Callable[[], ssl.SSLContext],
        on_over_budget: Callable[[Source, float], None],
        limits: HandshakeLimits,
    ) -> None:
        """`on_over_budget` gets addresses with too many handshakes."""
        self._context = context
        self._on_over_budget = on_over_budget
        self._limits = limits
        self._budgets: TokenBuckets[Source] = TokenBuckets(lambda _source: limits.allowance, time.monotonic)
        self._open: Counter[Source] = Counter()
        self._open_max_count = share_of_descriptors(limits.open_max_count, limits.descriptors_part)
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
        """Begin a handshake, or close a connection for which there is no room or no budget."""
        source = source_at(host)
        if self._open[source] >= self._limits.of_address_max_count or not self._budgets.take(source, HANDSHAKE_US):
            self._on_over_budget(source, self._budgets.wait_s(source, HANDSHAKE_US))
            accepted.close()
        elif self._open.total() >= self._open_max_count:
            accepted.close()
        else:
            self._open[source] += 1
            task = asyncio.get_running_loop().create_task(self._shake_hands(make, accepted, source))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _shake_hands(self, make: Callable[[], asyncio.Protocol], accepted: socket.socket, source: Source) -> None:
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
        finally:
            self._open[source] -= 1
            self._open += Counter()  # without those at 0


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
