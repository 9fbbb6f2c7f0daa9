"""A real HTTP proxy in front of one real node: hands on what it is asked and what the node says, and changes it on a wish.

The proxy takes the address at which the network knows the node, and the node another one: whoever asks cannot tell.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import aiohttp
from aiohttp import web

from node.config import CONFIG_FILE, config_to_toml, load_config
from tests.cluster.network_under_test import NetworkUnderTest, find_base_port

PROVED_PATH = "/v1/state-proofs"
ASKED_MAX_S = 60.0
RECORD_KEY = b"records\x00record/".hex()
_NOT_HANDED_ON = {"host", "content-length", "content-encoding", "transfer-encoding", "connection", "accept-encoding"}
Lie = Callable[[dict[str, Any]], bool]
"""Changes the answer to a question for proved values, and tells whether there was anything to change."""


def _flip_middle(digits: str) -> str:
    """Return hexadecimal digits with one of them changed."""
    middle = len(digits) // 2
    return f"{digits[:middle]}{int(digits[middle], 16) ^ 1:x}{digits[middle + 1 :]}"


def change_proof(answer: dict[str, Any]) -> bool:
    """Change one proof."""
    proofs = answer["proofs"]
    proofs[0]["proof"] = _flip_middle(proofs[0]["proof"])
    return True


def change_record(answer: dict[str, Any]) -> bool:
    """Change what stands of one record, and leave its proof as it is."""
    found = [each for each in answer["proofs"] if each["key"].startswith(RECORD_KEY) and each["value"]]
    for each in found[:1]:
        each["value"] = _flip_middle(each["value"])
    return bool(found)


class NodeInBetween:
    """The proxy. `lie` is what it changes, None if it hands on all as it is; `lies_count` how often it did."""

    def __init__(self, url: str) -> None:
        self.lie: Lie | None = None
        self.lies_count = 0
        self._url = url
        self._http = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=ASKED_MAX_S))

    async def close(self) -> None:
        """Close what it holds open towards the node."""
        await self._http.close()

    async def answer(self, request: web.Request) -> web.Response:
        """Ask the node what was asked, and hand on what it says."""
        headers = {name: value for name, value in request.headers.items() if name.lower() not in _NOT_HANDED_ON}
        try:
            async with self._http.request(
                request.method, self._url + request.path_qs, data=await request.read(), headers=headers
            ) as said:
                body, status = await said.read(), said.status
                told = {name: value for name, value in said.headers.items() if name.lower() not in _NOT_HANDED_ON}
        except aiohttp.ClientError:
            if request.transport is not None:
                request.transport.abort()  # where the node says nothing, nothing is said
            return web.Response(status=502)
        if self.lie is not None and request.path == PROVED_PATH and status == 200:
            answer = json.loads(body)
            if self.lie(answer):
                self.lies_count += 1
                body = json.dumps(answer).encode()
        return web.Response(status=status, body=body, headers=told)


@asynccontextmanager
async def stand_before(network: NetworkUnderTest, name: str) -> AsyncIterator[NodeInBetween]:
    """Put a proxy in front of a running node until the end of the block; then the node is where it was."""
    cluster, before = network.cluster, network.cluster.config(name)

    async def move(port: int) -> None:
        await asyncio.to_thread(cluster.stop, name)
        text = config_to_toml(dataclasses.replace(before, api_port=port))
        (before.data_dir / CONFIG_FILE).write_text(text, encoding="utf-8")
        cluster.configs[name] = load_config(before.data_dir)
        cluster.start(name)

    await move(find_base_port(1))
    between = NodeInBetween(network.url(name))
    app = web.Application(client_max_size=0)
    app.router.add_route("*", "/{path:.*}", between.answer)
    runner = web.AppRunner(app)
    await runner.setup()
    try:
        await web.TCPSite(runner, before.host, before.api_port).start()
        await cluster.wait_ready([name])
        yield between
    finally:
        await runner.cleanup()
        await between.close()
        await move(before.api_port)
        await cluster.wait_ready([name])
