"""Stories of nodes behind a proxy: who pays for what, and what slow strangers do to others."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from msgspec import Struct

from consensus.bounded_text import read_json_as
from network.bench.nginx import Nginx, configure, count_bodies_on_disk, trust_proxy
from network.lab.hosts.founded_network import HOSTS, ORGANISATIONS, FoundedNetwork, node_of
from network.lab.hosts.namespaces import SUBNET, Hosts
from network.lab.hosts.outcomes import Outcome, Tell, describe, end_clients
from network.lab.hosts.steady_clients import SteadyClients
from network.lab.hosts.visits import Crowd, Held, Slow, Told, Visit
from network.provisioning.network_layout import FIRST_PORT
from node.api.access.request_rate_limiter import ADDRESS_ALLOWANCE
from node.config import LOOPBACK
from node.limits.work_costs import ROUTE_DEFAULT_US

PROXIED = ("clinic", "hospital", "university")
DIRECT = "lab"
"""Clients reach this one without a proxy."""
PROXY_PORT, API_PORT, PEER_PORT = 443, FIRST_PORT + 1, FIRST_PORT
NEIGHBOUR = f"{SUBNET}.51"
HELLOS_COUNT = 48
"""Half-open handshakes of one stranger at each port, and as many requests that never end."""
WATCH_S = 15.0
CONNECT_MAX_MS = 1_500
"""For a new connection (p95) while strangers are slow, on a machine that is busy with other things."""


class ToldApart(Struct, kw_only=True):
    """What callers of a node behind a proxy were answered, and of one without, who is told to trust none but a proxy."""

    proxied: Told
    direct: Told

    def failures(self) -> list[str]:
        """What did not go as it should, in sentences."""
        return [f"{way}: {each}" for way in ("proxied", "direct") for each in _not_apart(getattr(self, way))]


class SlowStrangers(Outcome, kw_only=True):
    """Stretches: before, and while the stranger was there."""

    strangers: Held
    bodies_on_disk: int
    """How often a proxy began to keep a body on its disk."""

    def failures(self) -> list[str]:
        found = super().failures() + self.unconnected()
        slow_ms = max(seen.connect_p95_ms for seen in self.seen)
        found += [f"a new connection took {slow_ms:g} ms (p95)"] if slow_ms > CONNECT_MAX_MS else []
        found += [f"proxies kept {self.bodies_on_disk} bodies on their disks"] if self.bodies_on_disk else []
        return found + ([] if self.strangers.held else ["the stranger held no connection"])


def _not_apart(told: Told) -> list[str]:
    """A new budget for each forged address would have let all of the flood through."""
    allowed = (ADDRESS_ALLOWANCE.burst_us + told.flood_s * ADDRESS_ALLOWANCE.us_per_s) / ROUTE_DEFAULT_US
    found = [] if 0 < told.flood.get("200", 0) <= allowed else [f"of a flood from one address: {told.flood}"]
    for name, few in (("neighbour", told.neighbour), ("member", told.member), ("fellow", told.fellow)):
        if set(few) != {"200"}:
            found.append(f"the {name} paid for others: {few}")
    return found if told.greedy.get("RATE_LIMITED") else [*found, f"a member could ask for anything: {told.greedy}"]


@contextmanager
def proxied_network(place: Path, tell: Tell) -> Iterator[FoundedNetwork]:
    """Three nodes behind an nginx each, on the node's host, and one without."""
    tell("Six hosts. Three organisations put nginx before their nodes, the laboratory does not.")
    with Hosts(place, HOSTS) as hosts, ExitStack() as running:
        network = FoundedNetwork(hosts)
        behind = {
            name: ("--api-bind", LOOPBACK, "--api-url", f"https://{hosts.hosts[name].address}") for name in PROXIED
        }
        network.found(init=behind, before_start=_trust_own_proxy)
        for name in PROXIED:
            host = network.hosts[name]
            certificates = host.home / "proxy"
            issued = ("--organisation", name, "--host", host.address, "--out", str(certificates))
            network.run(host, "certificate", "issue", f"{name}-proxy", *issued)
            listen = f"{host.address}:{PROXY_PORT}"
            configuration = configure(f"{LOOPBACK}:{API_PORT}", listen, host.address, certificates)
            running.enter_context(Nginx(host.home / "nginx", configuration, host.prefix))
        tell("Each proxy has a certificate of its organisation; clients know its address from the genesis file.")
        yield network


def _trust_own_proxy(network: FoundedNetwork, organisation: str) -> None:
    trust_proxy(network.data_dir(organisation), LOOPBACK)


def tell_clients_apart(network: FoundedNetwork, tell: Tell) -> ToldApart:
    network.visitor.add_address(NEIGHBOUR)
    told = {}
    for name in ("hospital", DIRECT):
        tell(f"At {node_of(name)} one address asks far too much and forges X-Forwarded-For; others ask beside it.")
        codes = [network.issue_card(secrets.token_hex(8), "robot") for _ in range(2)]
        genesis = network.genesis_path.read_text(encoding="utf-8")
        with Visit(network, network.visitor, Crowd(genesis, node_of(name), codes, NEIGHBOUR)) as visit:
            told[name] = visit.go(Told)
        tell(f"  the address that asks too much: {told[name].flood}")
        tell(f"  another address: {told[name].neighbour}; a member's session behind the first: {told[name].member}")
        tell(f"  a member who asks too much: {told[name].greedy}; another beside: {told[name].fellow}")
    return ToldApart(proxied=told["hospital"], direct=told[DIRECT])


def bear_slow_strangers(network: FoundedNetwork, tell: Tell) -> SlowStrangers:
    """At each node's port for clients (of the proxy, where there is one) and for peers."""
    ports = {name: PROXY_PORT if name in PROXIED else API_PORT for name in ORGANISATIONS}
    places = [f"{network.hosts[name].address}:{port}" for name in ORGANISATIONS for port in (ports[name], PEER_PORT)]
    host = network.hosts["university"]
    with SteadyClients(network) as clients:
        clients.see()
        seen = [clients.see(WATCH_S)]
        tell(f"Before: {describe(seen[-1])}")
        with Visit(network, network.hosts["stranger"], Slow(places, HELLOS_COUNT)) as visit:
            tell(
                f"A stranger keeps {HELLOS_COUNT} half handshakes and half requests, some with bodies, at each of 8 ports."
            )
            tell(f"It holds {visit.go(Held).held} connections.")
            clients.see()
            seen.append(clients.see(WATCH_S))
            tell(f"Meanwhile: {describe(seen[-1])}")
            network.run(host, "down")
            network.run(host, "node", "run", node_of("university"), "--detach")
            network.wait(network.is_whole, "a node that was stopped has all its peers again")
            tell("A node that was stopped and started meanwhile has all its peers again.")
            strangers = read_json_as(visit.end(), Held)
        kept = end_clients(clients, tell)
    tell(f"The stranger opened {strangers.opened} connections, of which {strangers.held} were open at the end.")
    bodies = sum(count_bodies_on_disk(network.hosts[name].home / "nginx") for name in PROXIED)
    return SlowStrangers(seen=seen, kept=kept, strangers=strangers, bodies_on_disk=bodies)
