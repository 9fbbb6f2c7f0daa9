"""Stories of four organisations on hosts of their own, with clients at work: upgrades, wrong clocks, renewals, a liar."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from consensus.bounded_text import read_json_as
from network.lab.hosts.founded_network import HOSTS, ORGANISATIONS, PROGRAM, FoundedNetwork, node_of
from network.lab.hosts.namespaces import Hosts
from network.lab.hosts.outcomes import Outcome, Tell, describe, end_clients
from network.lab.hosts.steady_clients import SteadyClients
from network.provisioning.certificate_authority import NODE_LIFETIME_DAYS
from network.provisioning.node_certificates import get_authority, renew
from node.config import load_config
from node.faults import STATE_FILE_NAME

WATCH_S = 6.0
PACKAGES = ("clients", "consensus", "contracts", "network", "node", "pages")
CLOCKS_MS = {"clinic": 0, "hospital": 1_000, "lab": 2_000, "university": 3_000}
RENEWALS_COUNT, RENEW_EVERY_S, LIFETIME_S = 24, 3.0, 30.0
"""An hourly renewal for a day, compressed; a certificate counts for ten of its renewals."""
DAY_S = 24 * 3600.0
LIAR = "lab"


class Upgrade(Outcome, kw_only=True):
    """`versions`: of each node before and after. The node of each stretch is the one that was stopped in it."""

    versions: dict[str, tuple[str, str]]

    def failures(self) -> list[str]:
        found = super().failures()
        found += [f"{node} still runs {old}" for node, (old, new) in self.versions.items() if old == new]
        for stopped, seen in zip(self.versions, self.seen, strict=True):
            others = [each for each in seen.connections_refused if not each.startswith(f"{stopped} ")]
            found += [f"while {stopped} was upgraded, a connection failed: {each}" for each in others]
        return found


class Clocks(Outcome, kw_only=True):
    """`offsets_ms`: of each node's clock, as the node says. Stretches: right, apart, right again."""

    offsets_ms: dict[str, int]
    decided_height: int

    def failures(self) -> list[str]:
        spread_ms = max(self.offsets_ms.values()) - min(self.offsets_ms.values())
        return super().failures() + self.unconnected() + ([] if spread_ms >= 3_000 else ["no clock was set wrong"])


class Renewals(Outcome, kw_only=True):
    """`taken`: whether each node serves the last of its certificates; `expired`: how many that were served ran out."""

    renewals: int
    expired: int
    taken: dict[str, bool]

    def failures(self) -> list[str]:
        found = [f"{node} did not take its last certificate" for node, is_taken in self.taken.items() if not is_taken]
        return super().failures() + self.unconnected() + found + ([] if self.expired else ["no certificate ran out"])


class Liar(Outcome, kw_only=True):
    """`status` and `evidence` of the liar's seat are the proved state's. Stretches: before, while it lies, after."""

    liar: str
    status: str
    evidence: str

    def failures(self) -> list[str]:
        is_found = self.status == "suspended" and bool(self.evidence)
        return super().failures() + ([] if is_found else [f"{self.liar} was not found out"])


@contextmanager
def plain_network(place: Path, tell: Tell) -> Iterator[FoundedNetwork]:
    """Nodes that may be broken on purpose, each with its own ports open."""
    tell(
        "Six hosts on one network: four organisations with a node each, a visitor, a stranger. Founding takes a minute."
    )
    with Hosts(place, HOSTS) as hosts:
        network = FoundedNetwork(hosts)
        network.found(init=dict.fromkeys(ORGANISATIONS, ("--faults",)))
        tell("Each made its keys at home; the same genesis file came out everywhere; all nodes are linked.")
        yield network


def upgrade_one_by_one(network: FoundedNetwork, tell: Tell) -> Upgrade:
    """Each node is stopped and started from another copy of the program, of a later version; clients go on."""
    later = f"{version('blockrobot')}.post1"
    seen, versions = [], {}
    with SteadyClients(network) as clients:
        for name in ORGANISATIONS:
            host, before = network.hosts[name], str(network.status(name)["version"])
            clients.see()
            network.run(host, "down")
            network.programs[name] = _install_copy(host.home / "release", later)
            network.run(host, "node", "run", node_of(name), "--detach")
            network.wait(network.is_whole, f"{node_of(name)} is back with all its peers")
            seen.append(clients.see(WATCH_S))
            versions[node_of(name)] = (before, str(network.status(name)["version"]))
            tell(f"{node_of(name)} runs {versions[node_of(name)][1]} instead of {before}. {describe(seen[-1])}")
        kept = end_clients(clients, tell)
    return Upgrade(seen=seen, kept=kept, versions=versions)


def _install_copy(place: Path, later: str) -> Path:
    for package in PACKAGES:
        shutil.copytree(PROGRAM / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    facts = place / f"blockrobot-{later}.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: blockrobot\nVersion: {later}\n", encoding="utf-8")
    return place


def differ_clocks(network: FoundedNetwork, tell: Tell) -> Clocks:
    """Clocks up to three seconds apart: nothing stops, and organisations still decide."""
    with SteadyClients(network) as clients:
        clients.see()
        seen = [clients.see(WATCH_S)]
        tell(f"Clocks are right. {describe(seen[-1])}")
        for name, offset_ms in CLOCKS_MS.items():
            network.run(network.hosts[name], "fault", "skew", node_of(name), f"{offset_ms}ms")
        offsets_ms = {node_of(name): _clock_offset_ms(network, name) for name in CLOCKS_MS}
        decided_height = network.propose("clinic")
        seen.append(clients.see(2 * WATCH_S))
        tell(f"Clocks are up to 3 s apart, a decision was final at height {decided_height}. {describe(seen[-1])}")
        for name in CLOCKS_MS:
            network.run(network.hosts[name], "fault", "skew", node_of(name), "0")
        seen.append(clients.see(WATCH_S))
        tell(f"Clocks are right again. {describe(seen[-1])}")
        kept = end_clients(clients, tell)
    return Clocks(seen=seen, kept=kept, offsets_ms=offsets_ms, decided_height=decided_height)


def _clock_offset_ms(network: FoundedNetwork, organisation: str) -> int:
    file = network.data_dir(organisation) / STATE_FILE_NAME
    return int(read_json_as(file.read_bytes(), dict[str, Any])["clock_offset_ms"]) if file.is_file() else 0


def renew_all_day(network: FoundedNetwork, tell: Tell) -> Renewals:
    """Certificates that count for half a minute, renewed again and again while clients make new connections."""
    ends_ms: dict[str, int] = {}
    with SteadyClients(network) as clients:
        clients.see()
        for number in range(1, RENEWALS_COUNT + 1):
            _renew_everywhere(network, days=LIFETIME_S / DAY_S)
            time.sleep(RENEW_EVERY_S)
            if number % 6 == 0:
                ends_ms |= dict(_served(network, name) for name in ORGANISATIONS)
                tell(f"Each node was given its certificate no. {number}, which counts for {LIFETIME_S:g} s.")
        expired = sum(end_ms < time.time() * 1000 for end_ms in ends_ms.values())
        last = _renew_everywhere(network)
        time.sleep(RENEW_EVERY_S)
        taken = {node_of(name): _served(network, name)[0] == serial for name, serial in last.items()}
        network.wait(network.is_whole, "all nodes are linked")
        seen = [clients.see(WATCH_S)]
        tell(describe(seen[-1]))
        kept = end_clients(clients, tell)
    return Renewals(seen=seen, kept=kept, renewals=RENEWALS_COUNT, expired=expired, taken=taken)


def _renew_everywhere(network: FoundedNetwork, days: float = NODE_LIFETIME_DAYS) -> dict[str, str]:
    """Serial numbers by organisation."""
    return {
        name: f"{renew(load_config(network.data_dir(name)), get_authority(network.folder(name), name), days=days):x}"
        for name in ORGANISATIONS
    }


def _served(network: FoundedNetwork, name: str) -> tuple[str, int]:
    """Serial number and end (ms) of the certificate that a node shows."""
    certificate = network.status(name)["certificate"]
    return str(certificate["serial"]), int(certificate["not_after_ms"])


def catch_a_liar(network: FoundedNetwork, tell: Tell) -> Liar:
    """One organisation's node signs two blocks for one round; the others go on, and the evidence is on the chain."""
    host, node = network.hosts[LIAR], node_of(LIAR)
    with SteadyClients(network) as clients:
        clients.see()
        seen = [clients.see(WATCH_S)]
        tell(f"All are honest. {describe(seen[-1])}")
        network.run(host, "fault", "byzantine", node, "equivocate")
        tell(f"{node} now signs two blocks whenever it leads.")
        network.wait(lambda: _seat(network, node)[0] == "suspended", f"{node} is suspended")
        status, evidence = _seat(network, node)
        seen.append(clients.see(WATCH_S))
        tell(f"The chain holds the evidence ({evidence}) and has suspended {node}. {describe(seen[-1])}")
        network.run(host, "fault", "restart", node)
        seen.append(clients.see(WATCH_S))
        tell(f"It is honest again, and stays suspended until the organisations decide. {describe(seen[-1])}")
        kept = end_clients(clients, tell)
    return Liar(seen=seen, kept=kept, liar=node, status=status, evidence=evidence)


def _seat(network: FoundedNetwork, node: str) -> tuple[str, str]:
    """Status and kind of evidence, proved to the clinic."""
    listed = network.ask(network.hosts["clinic"], "producer", "list", "--as", "clinic")["producers"]
    (row,) = (row for row in listed if row["node"] == node)
    return str(row["status"]), str(row["evidence"]["kind"]) if row["evidence"] else ""
