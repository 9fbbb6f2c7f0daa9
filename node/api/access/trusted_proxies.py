"""Whose request it is, where proxies that the operator named stand before a node."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from ipaddress import IPv4Network, IPv6Network, ip_network

from aiohttp import web

from pages.listening import plain_address

HEADER = "X-Forwarded-For"
HOPS_MAX_COUNT = 8
Network = IPv4Network | IPv6Network


class TrustedProxies:
    """Believes the header of these proxies alone, and of the addresses in it only what they added themselves."""

    def __init__(self, networks: Iterable[str] = ()) -> None:
        """`networks`: addresses, or networks as 10.0.0.0/24. Raises ValueError."""
        self._networks: tuple[Network, ...] = tuple(ip_network(network) for network in networks)

    def address_of(self, request: web.BaseRequest) -> str | None:
        """Return the client's address as far as it is known: the last one before those that are trusted."""
        if not self._networks:
            return request.remote
        return self.find(request.remote, request.headers.getall(HEADER, []))

    def find(self, remote: str | None, headers: Sequence[str]) -> str | None:
        """As `address_of`, by the other side's address and the values of its headers."""
        if remote is None or not self.trusts(remote):
            return remote
        known = remote
        for told in reversed([part.strip() for value in headers for part in value.split(",")][-HOPS_MAX_COUNT:]):
            try:
                address = str(plain_address(told))
            except ValueError:
                return known
            known = address
            if not self.trusts(address):
                return known
        return known

    def trusts(self, host: str) -> bool:
        try:
            address = plain_address(host)
        except ValueError:
            return False
        return any(address in network for network in self._networks)


NO_PROXIES = TrustedProxies()
