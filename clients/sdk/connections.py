"""HTTP connections in isolated lanes: one key (or none) each, no cookies, so nodes cannot link keys by connection."""

from __future__ import annotations

import io
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import aiohttp

from clients.sdk.node_answers import read_problem
from consensus.errors import BlockRobotError
from pages.listening import is_loopback
from pages.name_lookups import NameLookups

CONNECT_TIMEOUT_MS = 3_000
REQUEST_TIMEOUT_MS = 15_000
ANSWER_MAX_BYTES = 64 * 1024 * 1024
LANES_MAX_COUNT = 256
TLS_CONTEXTS_MAX_COUNT = 128
ANONYMOUS_LANE = b""


@dataclass(frozen=True, slots=True)
class NodeAddress:
    """A node's name, URL, and organisation's CA certificate (PEM) for HTTPS.

    `is_given`: by the user, who may know a way (a proxy, a new address) that the certificate does not name; it has to
    name the node.
    """

    name: str
    url: str
    ca_certificate: str = ""
    is_given: bool = False


def check_address(node: NodeAddress) -> NodeAddress:
    """Require HTTPS, or plain HTTP on loopback. Raises CONFIGURATION_INVALID."""
    try:
        parts = urlsplit(node.url)
        host = parts.hostname
    except ValueError:
        host = None
    whose = f"node {node.name}" if node.name else "the node"
    if host is None or parts.scheme not in {"http", "https"}:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The address of {whose} is no HTTP address.")
    if parts.scheme == "http" and not is_loopback(host):
        raise BlockRobotError("CONFIGURATION_INVALID", f"The address of {whose} is not on loopback, so it needs HTTPS.")
    return node


def tls_context(node: NodeAddress) -> ssl.SSLContext | bool:
    """Trust only the organisation's CA."""
    if urlsplit(node.url).scheme != "https":
        return True
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # the authority may itself be certified by another
    try:
        context.load_verify_locations(cadata=node.ca_certificate)
    except (ssl.SSLError, ValueError):
        raise BlockRobotError("NODE_UNREACHABLE", f"Node {node.name} has no certificate authority to check.") from None
    return context


class Connections:
    """One client's lanes. Close it when done."""

    def __init__(self) -> None:
        self._tls: dict[NodeAddress, ssl.SSLContext | bool] = {}
        self._lanes: dict[bytes, aiohttp.ClientSession] = {}
        self._lookups = NameLookups()

    def _lane(self, lane: bytes) -> tuple[aiohttp.ClientSession, list[aiohttp.ClientSession]]:
        client = self._lanes.pop(lane, None)
        if client is None:
            client = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=64, resolver=self._lookups),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": "blockrobot"},
                trust_env=False,
            )
        self._lanes[lane] = client
        crowded = [self._lanes.pop(next(iter(self._lanes))) for _ in range(len(self._lanes) - LANES_MAX_COUNT)]
        return client, crowded

    def _tls_of(self, node: NodeAddress) -> ssl.SSLContext | bool:
        if node not in self._tls:
            while len(self._tls) >= TLS_CONTEXTS_MAX_COUNT:
                del self._tls[next(iter(self._tls))]
            self._tls[node] = tls_context(node)
        return self._tls[node]

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
        """Return the body. Raises NODE_UNREACHABLE, the problem's code, or INTERNAL; NODE_ADDRESS_WRONG if given."""
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
                ssl=self._tls_of(node),
                server_hostname=node.name if node.is_given and node.url.startswith("https:") else None,
            ) as response:
                content = await _read_bounded(response)
                if response.status >= 300:
                    raise read_problem(content, response.status)
                return content
        except (
            aiohttp.ClientError,
            TimeoutError,
            OSError,
            UnicodeError,
        ) as error:  # the last: a name that IDNA refuses
            if node.is_given and isinstance(error, aiohttp.ClientSSLError):
                sentence = f"{urlsplit(node.url).netloc} shows no certificate of {node.name!r} by its organisation."
                raise BlockRobotError("NODE_ADDRESS_WRONG", sentence) from None
            raise BlockRobotError(
                "NODE_UNREACHABLE", f"Node {node.name} did not answer ({type(error).__name__})."
            ) from None

    async def close_lane(self, lane: bytes) -> None:
        client = self._lanes.pop(lane, None)
        if client is not None:
            await client.close()

    async def close(self) -> None:
        for lane in list(self._lanes):
            await self.close_lane(lane)


async def _read_bounded(response: Any) -> bytes:
    content = bytearray()
    async for chunk in response.content.iter_chunked(256 * 1024):
        content += chunk
        if len(content) > ANSWER_MAX_BYTES:
            raise BlockRobotError("INTERNAL", "The node's answer is larger than any answer may be.")
    return bytes(content)
