"""A client that begins a request with a body and resets its connection, as one that was killed does."""

from __future__ import annotations

import asyncio
import socket
import struct

_RESET_AT_ONCE = struct.pack("ii", 1, 0)


async def send_and_reset(port: int | None, head: bytes, host: str = "127.0.0.1") -> None:
    """Send a request's lines, with less of a body than they promise; return once the server took note of the reset."""
    before = asyncio.all_tasks()
    with socket.create_connection((host, port or 0)) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_AT_ONCE)
        client.sendall(head + b"Content-Length: 9\r\n\r\n{")
        for _ in range(200):
            await asyncio.sleep(0)
    async with asyncio.timeout(5):
        while tasks := asyncio.all_tasks() - before:
            await asyncio.wait(tasks)
