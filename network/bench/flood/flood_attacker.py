"""`python -m network.bench.flood.flood_attacker`: a process that floods a local network.

Orders come as JSON on standard input, because they contain keys.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import ssl
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import msgspec
from msgspec import Struct

from consensus.bounded_text import read_json_text
from consensus.chain.session_message import sign_session
from consensus.primitives.encoding import encode
from consensus.primitives.keys import PrivateKey
from network.bench.flood.flood_kinds import FRAMES, HANDSHAKES, HttpFlood, Identity, Target, pool_of
from network.bench.flood.flood_routes import CostlyTargets, http_flood
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello, encode_frame

HOST = "127.0.0.1"
RATE_MAX_BYTES_PER_S = 20_000_000
CONNECTIONS_OF_NODE_COUNT = 16
DRIP_INTERVAL_S = 1.0
DRIPS_MAX_COUNT = 10
STREAM_READ_BYTES = 400_000
"""So much of a stream is read before it is opened again."""


class Orders(Struct, frozen=True, kw_only=True):
    """What to send, for how long, to whom, with which keys."""

    parent: int
    address: str
    kind: str
    identity: Identity
    seconds: float
    chain_id: str
    member: str
    key: str
    epoch: int
    round: int
    head_id: str
    name: str
    keys: str
    own_port: int
    api_ports: dict[str, int]
    landmarks: CostlyTargets
    p2p_ports: list[int]


class Sent(Struct, frozen=True, kw_only=True):
    """What the attacker sent, and how often it was refused, or cut off."""

    sent_bytes: int = 0
    messages: int = 0
    connections: int = 0
    refused: int = 0


class _Rate:
    """Limits bytes per second over all connections."""

    def __init__(self) -> None:
        self._started_s = time.monotonic()
        self.sent_bytes = 0
        self.messages_count = 0

    async def pay(self, size: int) -> None:
        self.sent_bytes += size
        self.messages_count += 1
        ahead_s = self.sent_bytes / RATE_MAX_BYTES_PER_S - (time.monotonic() - self._started_s)
        if ahead_s > 0.02:
            await asyncio.sleep(ahead_s)


class _Attack:
    def __init__(self, orders: Orders) -> None:
        self.orders = orders
        self.rate = _Rate()
        self.refused_count = 0
        self.connections_count = 0
        self.target = Target(
            chain_id=bytes.fromhex(orders.chain_id),
            member=bytes.fromhex(orders.member),
            epoch=orders.epoch,
            round=orders.round,
            head_id=bytes.fromhex(orders.head_id),
            name=orders.name,
            key=PrivateKey(bytes.fromhex(orders.key)),
        )
        self._until_s = time.monotonic() + orders.seconds

    @property
    def _goes_on(self) -> bool:
        return time.monotonic() < self._until_s and os.getppid() == self.orders.parent

    async def run(self) -> None:
        kind = self.orders.kind
        if kind in FRAMES:
            work = [self._listen_as_node(kind)]
        elif kind == HANDSHAKES:
            work = [self._shake_hands(port) for port in self.orders.p2p_ports for _ in range(4)]
        else:
            flood = http_flood(kind, self.orders.landmarks)
            work = [
                self._request(flood, port, name)
                for name, port in self.orders.api_ports.items()
                for _ in range(CONNECTIONS_OF_NODE_COUNT)
            ]
        await asyncio.gather(*work)

    # As a node

    async def _listen_as_node(self, kind: str) -> None:
        folder = Path(self.orders.keys)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.load_cert_chain(folder / "tls.crt.pem", folder / "tls.key.pem")
        messages = pool_of(FRAMES[kind], self.target)

        async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self.connections_count += 1
            swallowing = asyncio.create_task(_swallow(reader))
            hello = Hello(PROTOCOL_VERSION, self.target.chain_id, self.target.name, 0)
            with contextlib.suppress(OSError, asyncio.CancelledError):
                writer.write(encode_frame(FrameKind.HELLO, encode(hello)))
                await self._send_all(messages, writer)
            self.refused_count += self._goes_on
            swallowing.cancel()
            writer.close()

        async with await asyncio.start_server(flood, HOST, self.orders.own_port, ssl=context):
            await asyncio.sleep(self.orders.seconds)

    async def _send_all(self, messages: Iterator[bytes], writer: asyncio.StreamWriter) -> None:
        while self._goes_on and not writer.is_closing():
            message = next(messages)
            writer.write(message)
            await self.rate.pay(len(message))
            await writer.drain()
            await asyncio.sleep(0)  # lets the loop notice a connection that is gone

    async def _shake_hands(self, port: int) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        while self._goes_on:
            try:
                async with asyncio.timeout(2):
                    reader, writer = await asyncio.open_connection(
                        HOST, port, ssl=context, local_addr=(self.orders.address, 0)
                    )
                    self.connections_count += 1
                    await reader.read(1)
                    writer.close()
            except (OSError, TimeoutError):
                self.refused_count += 1
            await self.rate.pay(2_000)
            await asyncio.sleep(0)

    # As a client

    async def _request(self, flood: HttpFlood, port: int, node: str) -> None:
        token = await self._open_session(port, node) if self.orders.identity in {"member", "robot"} else None
        bodies = pool_of(flood.body, self.target, 8)
        while self._goes_on:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, ValueError, TimeoutError):
                reader, writer = await asyncio.open_connection(HOST, port, local_addr=(self.orders.address, 0))
                self.connections_count += 1
                try:
                    await self._ask(flood, token, bodies, reader, writer)
                finally:
                    writer.close()
            await asyncio.sleep(0.001)

    async def _ask(
        self,
        flood: HttpFlood,
        token: str | None,
        bodies: Iterator[bytes],
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        while self._goes_on:
            body = next(bodies)
            head = f"{flood.method} {flood.path} HTTP/1.1\r\nHost: node\r\nContent-Type: {flood.media_type}\r\n"
            head += flood.headers
            head += (
                f"Content-Length: {len(body)}\r\n" + (f"Authorization: Bearer {token}\r\n" if token else "") + "\r\n"
            )
            writer.write(head.encode())
            if flood.drips:
                for start in range(0, min(len(body), DRIPS_MAX_COUNT * 100), 100):
                    writer.write(body[start : start + 100])
                    await writer.drain()
                    await self.rate.pay(100)
                    await asyncio.sleep(DRIP_INTERVAL_S)
            writer.write(body[DRIPS_MAX_COUNT * 100 :] if flood.drips else body)
            await self.rate.pay(len(head) + len(body))
            async with asyncio.timeout(5):
                await writer.drain()
                if not await self._read_answer(flood, reader):
                    return

    async def _read_answer(self, flood: HttpFlood, reader: asyncio.StreamReader) -> bool:
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
        self.refused_count += " 429 " in head.split("\r\n", 1)[0]
        lengths = [line.partition(":")[2] for line in head.split("\r\n") if line.startswith("content-length:")]
        if flood.streams and not lengths:
            read = 0
            while read < STREAM_READ_BYTES and self._goes_on:
                read += len(content := await reader.read(1 << 18))
                if not content:
                    break
            return False
        await reader.readexactly(int(lengths[0]) if lengths else 0)
        return "connection: close" not in head

    async def _open_session(self, port: int, node: str) -> str:
        public = self.target.key.public_key.hex()
        async with aiohttp.ClientSession(f"http://{HOST}:{port}") as http:
            async with http.post("/v1/session-challenges", json={"public_key": public}) as response:
                challenge = (await response.json(content_type=None)).get("challenge", secrets.token_hex(32))
            signature = sign_session(self.target.key, self.target.chain_id, node, bytes.fromhex(challenge)).hex()
            document = {"public_key": public, "challenge": challenge, "signature": signature}
            async with http.post("/v1/sessions", json=document) as response:
                return str((await response.json(content_type=None)).get("token", "00" * 32))


async def _swallow(reader: asyncio.StreamReader) -> None:
    with contextlib.suppress(OSError):
        while await reader.read(1 << 20):
            pass


def main() -> None:
    attack = _Attack(msgspec.convert(read_json_text(sys.stdin.read()), Orders))
    asyncio.run(attack.run())
    sent = Sent(
        sent_bytes=attack.rate.sent_bytes,
        messages=attack.rate.messages_count,
        connections=attack.connections_count,
        refused=attack.refused_count,
    )
    sys.stdout.write(msgspec.json.encode(sent).decode())


if __name__ == "__main__":
    main()
