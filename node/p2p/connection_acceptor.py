"""Accepts other nodes' connections until the handshake ends, limited by address."""

from __future__ import annotations

import asyncio
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable

from consensus.errors import BlockRobotError
from node.limits.token_buckets import Allowance, Source, TokenBuckets, source_at
from pages.listening import accept_each, open_listener, share_of_descriptors

HANDSHAKE_TIMEOUT_MS = 5_000
SHUTDOWN_TIMEOUT_MS = 1_000
"""For how long a closed connection may wait for the other side to confirm."""
HANDSHAKE_US = 3_000
HANDSHAKES_OPEN_MAX_COUNT, HANDSHAKES_OF_ADDRESS_MAX_COUNT = 64, 32
HANDSHAKE_ALLOWANCE = Allowance(us_per_s=20 * HANDSHAKE_US, burst_us=60 * HANDSHAKE_US)
"""By address: twenty handshakes a second."""
_DESCRIPTORS_PART = 16


class ConnectionAcceptor:
    """The connections whose handshakes are open."""

    def __init__(
        self,
        make: Callable[[], asyncio.Protocol],
        context: Callable[[], ssl.SSLContext],
        on_over_budget: Callable[[Source, float], None],
    ) -> None:
        """`make` builds a connection's protocol; `on_over_budget` gets addresses with too many handshakes."""
        self._make = make
        self._context = context
        self._on_over_budget = on_over_budget
        self._budgets: TokenBuckets[str] = TokenBuckets(lambda _host: HANDSHAKE_ALLOWANCE, time.monotonic)
        self._open: Counter[str] = Counter()
        self._open_max_count = share_of_descriptors(HANDSHAKES_OPEN_MAX_COUNT, _DESCRIPTORS_PART)
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self, listener: socket.socket) -> None:
        try:
            await accept_each(listener, self._take)
        finally:
            for task in self._tasks:
                task.cancel()

    async def _take(self, accepted: socket.socket, host: str) -> None:
        if self._open[host] >= HANDSHAKES_OF_ADDRESS_MAX_COUNT or not self._budgets.take(host, HANDSHAKE_US):
            self._on_over_budget(source_at(host), self._budgets.wait_s(host, HANDSHAKE_US))
            accepted.close()
        elif self._open.total() >= self._open_max_count:
            accepted.close()
        else:
            self._open[host] += 1
            task = asyncio.get_running_loop().create_task(self._shake_hands(accepted, host))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _shake_hands(self, accepted: socket.socket, host: str) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                self._make,
                accepted,
                ssl=self._context(),
                ssl_handshake_timeout=HANDSHAKE_TIMEOUT_MS / 1000,
                ssl_shutdown_timeout=SHUTDOWN_TIMEOUT_MS / 1000,
            )
        except (OSError, TimeoutError):
            accepted.close()
        finally:
            self._open[host] -= 1
            self._open += Counter()  # without those at 0


def bind_listener(host: str, port: int) -> socket.socket:
    """Raises PORT_IN_USE."""
    try:
        return open_listener(host, port)
    except OSError:
        raise BlockRobotError("PORT_IN_USE", f"Another program already listens on {host}:{port}.") from None
