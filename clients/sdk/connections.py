"""HTTP connections to nodes, in lanes that share nothing. Must never let two keys meet on one connection.

A lane stands for one key (an owner key, a member key, or none): it has its own connections, no cookies, and no memory
of any other lane. A node that wanted to link a visit's owner key to a member would have to do it by address and time.
"""

from __future__ import annotations

import io
import ipaddress
import ssl
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import aiohttp

from clients.sdk.answers import read_problem
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis

CONNECT_TIMEOUT_MS = 3_000
REQUEST_TIMEOUT_MS = 15_000
ANSWER_MAX_BYTES = 64 * 1024 * 1024
LANES_MAX_COUNT = 256
NO_LANE = b""


@dataclass(frozen=True, slots=True)
class NodeAddress:
    """A node's name, as genesis has it, and where its interface is."""

    name: str
    url: str


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def resolve_addresses(genesis: Genesis, urls: Mapping[str, str] | None) -> tuple[NodeAddress, ...]:
    """Return the nodes to ask: those of genesis, or those of `urls` (name -> URL; names must be in genesis).

    Plain HTTP is for loopback only. Raises CONFIGURATION_INVALID.
    """
    chosen = {node.name: node.api_url for node in genesis.nodes} if urls is None else dict(urls)
    known = {node.name for node in genesis.nodes}
    if not chosen:
        raise BlockRobotError("CONFIGURATION_INVALID", "There is no node to ask.")
    for name, url in chosen.items():
        parts = urlsplit(url)
        if name not in known:
            raise BlockRobotError("CONFIGURATION_INVALID", f"The genesis file names no node {name!r}.")
        if parts.scheme not in {"http", "https"} or parts.hostname is None:
            raise BlockRobotError("CONFIGURATION_INVALID", f"The address of node {name} is no HTTP address.")
        if parts.scheme == "http" and not _is_loopback(parts.hostname):
            raise BlockRobotError("CONFIGURATION_INVALID", f"Node {name} is not on loopback, so it needs HTTPS.")
    return tuple(NodeAddress(name, url.rstrip("/")) for name, url in chosen.items())


def _tls_contexts(genesis: Genesis, nodes: Sequence[NodeAddress]) -> dict[str, ssl.SSLContext]:
    """Return for each node behind HTTPS a TLS context that trusts its organisation's CA and nothing else."""
    certificates = {organisation.name: organisation.ca_certificate for organisation in genesis.organisations}
    contexts: dict[str, ssl.SSLContext] = {}
    for node in nodes:
        if urlsplit(node.url).scheme == "https":
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.minimum_version = ssl.TLSVersion.TLSv1_3
            context.load_verify_locations(cadata=certificates[genesis.node(node.name).organisation])
            contexts[node.name] = context
    return contexts


class Connections:
    """The lanes of one client. Close it when done."""

    def __init__(self, genesis: Genesis, nodes: Sequence[NodeAddress]) -> None:
        self._tls = _tls_contexts(genesis, nodes)
        self._lanes: dict[bytes, aiohttp.ClientSession] = {}

    def _lane(self, lane: bytes) -> tuple[aiohttp.ClientSession, list[aiohttp.ClientSession]]:
        """Return the lane's client and the clients that had to make room for it."""
        client = self._lanes.pop(lane, None)
        if client is None:
            client = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=64),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": "blockrobot"},
                trust_env=False,
            )
        self._lanes[lane] = client
        crowded = [self._lanes.pop(next(iter(self._lanes))) for _ in range(len(self._lanes) - LANES_MAX_COUNT)]
        return client, crowded

    async def request(
        self,
        node: NodeAddress,
        method: str,
        path: str,
        *,
        lane: bytes,
        body: bytes | None = None,
        media_type: str = "application/json",
        query: Mapping[str, str | int] | None = None,
        token: str | None = None,
        timeout_ms: int = REQUEST_TIMEOUT_MS,
    ) -> bytes:
        """Make one request and return the answer's body.

        Raises NODE_UNREACHABLE, the code of the node's problem document, or INTERNAL if the answer is neither.
        """
        headers = {} if body is None else {"Content-Type": media_type}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        client, crowded = self._lane(lane)
        for other in crowded:
            await other.close()
        timeout = aiohttp.ClientTimeout(total=timeout_ms / 1000, connect=CONNECT_TIMEOUT_MS / 1000)
        try:
            async with client.request(
                method,
                node.url + path,
                data=None if body is None else io.BytesIO(body),
                params=dict(query or {}),
                headers=headers,
                timeout=timeout,
                allow_redirects=False,
                ssl=self._tls.get(node.name, True),
            ) as response:
                content = await _read_bounded(response)
                if response.status >= 300:
                    raise read_problem(content, response.status)
                return content
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            raise BlockRobotError(
                "NODE_UNREACHABLE", f"Node {node.name} did not answer ({type(error).__name__})."
            ) from None

    async def close_lane(self, lane: bytes) -> None:
        """Close the connections of one key; a lane that is not open is no error."""
        client = self._lanes.pop(lane, None)
        if client is not None:
            await client.close()

    async def close(self) -> None:
        """Close every connection."""
        for lane in list(self._lanes):
            await self.close_lane(lane)


async def _read_bounded(response: Any) -> bytes:
    content = bytearray()
    async for chunk in response.content.iter_chunked(256 * 1024):
        content += chunk
        if len(content) > ANSWER_MAX_BYTES:
            raise BlockRobotError("INTERNAL", "The node's answer is larger than any answer may be.")
    return bytes(content)
