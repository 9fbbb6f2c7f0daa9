"""Where nodes are reached and listen: each address in one canonical form, so that one place is never two."""

from __future__ import annotations

import ipaddress
import re
from urllib.parse import urlsplit

from clients.sdk.connections import NodeAddress, check_address
from consensus.errors import BlockRobotError
from pages.listening import plain_address

HOST_MAX_CHARS = 253
PORT_MAX = 65_535
_URL_MAX_CHARS = 256
_DEFAULT_PORTS = {"http": 80, "https": 443}
_LABEL = re.compile(r"[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9_])?")
_NUMBER = re.compile(r"[0-9]+|0x[0-9a-f]*")
"""As the last label of a name that some resolvers read as an IPv4 address: 127.1."""
_URL = re.compile(r"https?://[A-Za-z0-9._:\[\]-]+/?")


def canonical_host(text: str) -> str:
    """An IP address as `ipaddress` writes it, IPv4 where it is mapped; a name in small letters. Raises ValueError."""
    if not text.isascii() or "%" in text:
        raise ValueError(text)
    try:
        return str(plain_address(text))
    except ValueError:
        host = text.lower().removesuffix(".")
    labels = host.split(".")
    if len(host) > HOST_MAX_CHARS or not all(map(_LABEL.fullmatch, labels)) or _NUMBER.fullmatch(labels[-1]):
        raise ValueError(text)
    host.encode("idna").decode("idna")  # what it refuses, no client asks for
    return host


def url_of(scheme: str, host: str, port: int) -> str:
    """`host` and `port` as they are, the port only if it is not the scheme's own."""
    shown = f"[{host}]" if ":" in host else host
    return f"{scheme}://{shown}" + ("" if port == _DEFAULT_PORTS[scheme] else f":{port}")


def place_of(url: str) -> tuple[str, int]:
    """Host and port behind a canonical URL."""
    parts = urlsplit(url)
    return parts.hostname or "", parts.port or _DEFAULT_PORTS[parts.scheme]


def canonical_url(url: str) -> str:
    """Raises NODE_ADDRESS_UNUSABLE unless it is http(s)://HOST[:PORT], with nothing before or behind."""
    try:
        parts = urlsplit(url)
        port = _DEFAULT_PORTS.get(parts.scheme) if parts.port is None else parts.port
        if len(url) > _URL_MAX_CHARS or not _URL.fullmatch(url) or not port or not parts.hostname:
            raise ValueError(url)
        return url_of(parts.scheme, canonical_host(parts.hostname), port)
    except ValueError:
        detail = "An address for clients is https://HOST[:PORT], without a user, a path, a query or a fragment."
        raise BlockRobotError("NODE_ADDRESS_UNUSABLE", detail) from None


def check_place(name: str, host: str, port: int, api_url: str) -> None:
    """Reject where nobody would reach a node, and what has a canonical form and is not in it.

    Raises NODE_ADDRESS_UNUSABLE, and CONFIGURATION_INVALID for an address that no client would talk to.
    """
    try:
        canonical = canonical_host(host)
    except ValueError:
        raise BlockRobotError("NODE_ADDRESS_UNUSABLE", f"{host!r} is no host's name or address.") from None
    if not 0 < port <= PORT_MAX:
        raise BlockRobotError("NODE_ADDRESS_UNUSABLE", f"{port} is no port.")
    for text, wanted in ((host, canonical), (api_url, canonical_url(api_url))):
        if text != wanted:
            raise BlockRobotError("NODE_ADDRESS_UNUSABLE", f"The address {text!r} is written {wanted!r}.")
    try:
        check_address(NodeAddress(name, api_url))
    except BlockRobotError:
        detail = (
            f"No client would talk to {name} at {api_url}: beyond this machine clients take https:// only, with a "
            "certificate of the organisation's authority. Name such an address with --api-url, or leave it to the node."
        )
        raise BlockRobotError("CONFIGURATION_INVALID", detail) from None


def check_listening(option: str, address: str) -> None:
    """A node listens at an IP address. Raises CONFIGURATION_INVALID."""
    try:
        ipaddress.ip_address(address)
    except ValueError:
        detail = (
            f"{option} takes an IP address of this machine, without a port, as 10.0.0.7 or fd00::7; not {address!r}."
        )
        raise BlockRobotError("CONFIGURATION_INVALID", detail) from None


def parse_place(text: str) -> tuple[str, int]:
    """Read HOST or HOST:PORT, an IPv6 address with a port in brackets; port 0: none is named.

    Raises CONFIGURATION_INVALID.
    """
    try:
        return canonical_host(text), 0
    except ValueError:
        pass
    try:
        parts = urlsplit(f"//{text}")
        host, port = canonical_host(parts.hostname or ""), parts.port or 0
        if parts.netloc != text or "@" in text or port > PORT_MAX - 1:
            raise ValueError(text)
    except ValueError:
        raise BlockRobotError("CONFIGURATION_INVALID", f"{text!r} is no HOST or HOST:PORT.") from None
    return host, port
