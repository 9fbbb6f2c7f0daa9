"""Follows one node's event stream and records times of finality.

Calls that emit nothing, such as refused ones, time out as errors.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from types import TracebackType

import aiohttp

from consensus.bounded_text import read_json_text
from consensus.chain.genesis import Genesis, NodeEntry
from consensus.chain.session_message import sign_session
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

LINE_MAX_BYTES = 256 * 1024


class FinalityFollower:
    """One node's open stream in a member's session; use as `async with`."""

    def __init__(self, genesis: Genesis, node: NodeEntry, key: PrivateKey) -> None:
        self._genesis = genesis
        self._node = node
        self._key = key
        self._waiting: dict[str, asyncio.Future[float]] = {}
        self._task: asyncio.Task[None] | None = None
        self._http: aiohttp.ClientSession | None = None

    async def __aenter__(self) -> FinalityFollower:
        self._http = aiohttp.ClientSession(
            timeout=aiohttp.ClientTimeout(total=None, sock_connect=10), read_bufsize=LINE_MAX_BYTES
        )
        try:
            token = await self._open_session(self._http)
            response = await self._http.get(
                f"{self._node.api_url}/v1/events", headers={"Authorization": f"Bearer {token}"}
            )
            if response.status != 200:
                raise BlockRobotError("NODE_UNREACHABLE", f"The event stream answered {response.status}.")
        except BaseException:
            await self._http.close()
            raise
        self._task = asyncio.create_task(self._follow(response))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        if self._http is not None:
            await self._http.close()

    async def _open_session(self, http: aiohttp.ClientSession) -> str:
        public = self._key.public_key.hex()
        async with http.post(f"{self._node.api_url}/v1/session-challenges", json={"public_key": public}) as response:
            challenge = bytes.fromhex((await response.json(content_type=None))["challenge"])
        signature = sign_session(self._key, self._genesis.chain_id, self._node.name, challenge)
        document = {"public_key": public, "challenge": challenge.hex(), "signature": signature.hex()}
        async with http.post(f"{self._node.api_url}/v1/sessions", json=document) as response:
            return str((await response.json(content_type=None))["token"])

    async def _follow(self, response: aiohttp.ClientResponse) -> None:
        async for line in response.content:
            if line.startswith(b"data: "):
                self._note(read_json_text(line[6:])["txid"], time.perf_counter())

    def _note(self, txid: str, at_s: float) -> None:
        waiting = self._waiting.pop(txid, None)
        if waiting is not None and not waiting.done():
            waiting.set_result(at_s)

    def expect(self, txids: Sequence[bytes]) -> dict[bytes, asyncio.Future[float]]:
        """Before submitting; futures give finality times (s)."""
        loop = asyncio.get_running_loop()
        futures = {txid: loop.create_future() for txid in txids}
        self._waiting.update({txid.hex(): future for txid, future in futures.items()})
        return futures

    def forget(self, txid: bytes) -> None:
        waiting = self._waiting.pop(txid.hex(), None)
        if waiting is not None:
            waiting.cancel()
