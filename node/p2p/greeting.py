"""Connections with a checked certificate awaiting the hello: deadline, limits, oldest evicted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from node.p2p.connection import PeerConnection
from pages.listening import share_of_descriptors

HELLO_TIMEOUT_MS = 5_000
UNGREETED_OF_PEER_MAX_COUNT = 2
UNGREETED_MAX_COUNT = 64
_DESCRIPTORS_PART = 16


class Greeting:
    """Connections awaiting the hello, the oldest first."""

    def __init__(self, give_up: Callable[[PeerConnection, str], None]) -> None:
        """`give_up` gets a connection to close, and why."""
        self._give_up = give_up
        self._max_count = share_of_descriptors(UNGREETED_MAX_COUNT, _DESCRIPTORS_PART)
        self._waiting: dict[PeerConnection, asyncio.TimerHandle] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, connection: PeerConnection) -> None:
        """Await the hello of a connection whose `peer` is known."""
        late = asyncio.get_running_loop().call_later(HELLO_TIMEOUT_MS / 1000, self._end, connection, "in time")
        self._waiting[connection] = late
        of_peer = [each for each in self._waiting if each.peer == connection.peer]
        if len(of_peer) > UNGREETED_OF_PEER_MAX_COUNT:
            self._end(of_peer[0], "while it made further connections")
        elif len(self._waiting) > self._max_count:
            self._end(next(iter(self._waiting)), "before others needed its place")

    def remove(self, connection: PeerConnection) -> None:
        late = self._waiting.pop(connection, None)
        if late is not None:
            late.cancel()

    def _end(self, connection: PeerConnection, why: str) -> None:
        self.remove(connection)
        self._give_up(connection, f"{connection.peer!r} shook hands and said no hello {why}.")
