"""Stories of four organisations of which one is away, with clients at work: cut off, or lost for good and made anew."""

from __future__ import annotations

import shutil

from network.lab.hosts.founded_network import FoundedNetwork, node_of
from network.lab.hosts.node_stories import WATCH_S
from network.lab.hosts.outcomes import Outcome, Tell, describe, end_clients
from network.lab.hosts.steady_clients import Seen, SteadyClients

AWAY, WATCHER = "lab", "clinic"


class Absence(Outcome, kw_only=True):
    """Stretches: all are there, one is away, it is back. Heights: of whoever is away, its last before and first after, and
    what was final elsewhere when it came back.
    """

    node: str
    height_away: int
    height_elsewhere: int
    height_back: int

    def failures(self) -> list[str]:
        found = [] if self.height_away < self.height_elsewhere else ["nothing was final while it was away"]
        return (
            super().failures() + found + ([] if self.height_back >= self.height_elsewhere else ["it did not catch up"])
        )


def cut_off(network: FoundedNetwork, tell: Tell) -> Absence:
    """One host hears nobody; the others go on; when it is back it has all that it missed."""
    host, node = network.hosts[AWAY], node_of(AWAY)
    with SteadyClients(network) as clients:
        clients.see()
        seen = [clients.see(WATCH_S)]
        tell(f"All are there. {describe(seen[-1])}")
        host.cut(off=True)
        height_away = _height(network, AWAY)
        tell(f"The host of {node} is cut off.")
        network.wait(lambda: node not in network.status(WATCHER)["peers"], f"{node} is missed")
        seen.append(clients.see(2 * WATCH_S))
        height_elsewhere = _height(network, WATCHER)
        tell(f"The others are at block {height_elsewhere}, {node} is at {height_away}. {describe(seen[-1])}")
        host.cut(off=False)
        return _come_back(network, clients, seen, (height_away, height_elsewhere), tell)


def lose_for_good(network: FoundedNetwork, tell: Tell) -> Absence:
    """A host burns down. Its node is made anew from a backup and its keys, which were kept elsewhere, and lacks nothing."""
    host, node, safe = network.hosts[AWAY], node_of(AWAY), network.visitor.home / "safe"
    data_dir = network.data_dir(AWAY)
    with SteadyClients(network) as clients:
        clients.see()
        network.run(host, "node", "backup", node, "--out", str(safe / "backup"))
        shutil.copytree(data_dir / "keys", safe / "keys")
        seen = [clients.see(WATCH_S)]
        tell(f"{node} is backed up while it runs. {describe(seen[-1])}")
        height_away = _height(network, AWAY)
        network.run(host, "down")
        shutil.rmtree(data_dir)
        tell(f"{node} and all that lay on its host is gone.")
        seen.append(clients.see(2 * WATCH_S))
        height_elsewhere = _height(network, WATCHER)
        tell(f"The others are at block {height_elsewhere}. {describe(seen[-1])}")
        words = ("--data-dir", str(data_dir), "--keys", str(safe / "keys"))
        network.run(host, "node", "restore", str(safe / "backup"), *words)
        network.run(host, "node", "run", node, "--restored", "--detach")
        return _come_back(network, clients, seen, (height_away, height_elsewhere), tell)


def _height(network: FoundedNetwork, organisation: str) -> int:
    return int(network.status(organisation)["finalized_height"])


def _come_back(
    network: FoundedNetwork, clients: SteadyClients, seen: list[Seen], heights: tuple[int, int], tell: Tell
) -> Absence:
    """`heights`: of whoever is away, and of the others."""
    node, (height_away, height_elsewhere) = node_of(AWAY), heights
    network.wait(lambda: _height(network, AWAY) >= height_elsewhere, f"{node} has caught up")
    network.wait(network.is_whole, "all nodes are linked")
    seen.append(clients.see(WATCH_S))
    tell(f"{node} is back and has all that is final. {describe(seen[-1])}")
    height_back = _height(network, AWAY)
    return Absence(
        seen=seen,
        kept=end_clients(clients, tell),
        node=node,
        height_away=height_away,
        height_elsewhere=height_elsewhere,
        height_back=height_back,
    )
