"""Four organisations on hosts of their own: one is cut off, one moves, a stranger listens; the others go on."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from network.lab.hosts.founded_network import ORGANISATIONS, FoundedNetwork, node_of
from network.lab.hosts.namespaces import Hosts

STORY_MAX_S = 300
pytestmark = pytest.mark.timeout(STORY_MAX_S)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FoundedNetwork]:
    with Hosts(tmp_path_factory.mktemp("hosts"), [*ORGANISATIONS, "visitor"]) as hosts:
        network = FoundedNetwork(hosts)
        network.found()
        yield network


def test_each_organisation_has_its_say_with_the_key_on_its_own_host(network: FoundedNetwork) -> None:
    heights = [network.propose(name) for name in ORGANISATIONS]
    assert heights == sorted(heights)
    assert len(set(heights)) == len(heights)
    keys = {name: list(network.hosts[name].home.rglob("admin.key")) for name in ORGANISATIONS}
    assert [len(found) for found in keys.values()] == [1] * 4


def test_a_host_that_is_cut_off_misses_nothing_once_it_is_back(network: FoundedNetwork) -> None:
    network.hosts["lab"].cut(off=True)
    reached = max(network.propose(name) for name in ("clinic", "hospital"))
    network.wait(lambda: node_of("lab") not in network.status("clinic")["peers"], "the laboratory is missed")
    assert network.status("lab")["finalized_height"] < reached
    network.hosts["lab"].cut(off=False)
    network.wait(lambda: network.status("lab")["finalized_height"] >= reached, "the laboratory has caught up")
    assert network.propose("lab") > reached


def test_a_stranger_on_the_network_reads_nothing_in_plain_text(network: FoundedNetwork) -> None:
    url = f"http://{network.hosts['hospital'].address}:7273/v1/genesis"
    done = subprocess.run([*network.visitor.prefix, "curl", "-sS", "-m", "5", url], capture_output=True, check=False)
    assert done.returncode != 0
    assert done.stdout == b""


def test_a_node_that_moves_is_found_at_its_new_address(network: FoundedNetwork) -> None:
    host, node = network.hosts["university"], node_of("university")
    old, new = host.address, "10.77.0.99"
    host.renumber(new)
    network.wait(lambda: node not in network.status("clinic")["peers"], "the old link is given up")
    network.run(host, "certificate", "renew", node, "--host", new, "--host", old)
    config = host.home / "br" / "network" / "nodes" / node / "node.toml"
    config.write_text(config.read_text().replace(f'host = "{old}"', f'host = "{new}"'))
    network.run(host, "down")
    network.run(host, "node", "run", node, "--detach")
    network.wait(lambda: len(network.status("university")["peers"]) == 3, "the moved node finds its peers")
    network.run(host, "org", "propose", "move-node", node, "--advertise", f"{new}:7272")
    listed = network.ask(network.hosts["clinic"], "org", "list", "--as", "clinic")["nodes"]
    assert [row["host"] for row in listed if row["name"] == node] == [new]
    network.wait(lambda: node in network.status("clinic")["peers"], "it is found where it is")
    assert network.propose("university") > 0


def test_a_host_that_is_lost_for_good_is_made_anew_from_a_backup_and_nothing_is_missing(
    network: FoundedNetwork, tmp_path: Path
) -> None:
    """A drill: the backup is of a running node, two calls are final after it, and the disk is gone."""
    host, node = network.hosts["hospital"], node_of("hospital")
    data_dir, keys = host.home / "br" / "network" / "nodes" / node, tmp_path / "safe"
    network.run(host, "node", "backup", node, "--out", str(tmp_path / "backup"))
    shutil.copytree(data_dir / "keys", keys)
    reached = max(network.propose(name) for name in ("clinic", "lab"))
    network.run(host, "down")
    shutil.rmtree(data_dir)
    network.run(host, "node", "restore", str(tmp_path / "backup"), "--data-dir", str(data_dir), "--keys", str(keys))
    with network.spawn(host, "network.cli.main", "node", "run", str(data_dir), "--restored") as restored:
        try:
            network.wait(lambda: network.status("hospital")["finalized_height"] >= reached, "it has all that is final")
            network.wait(lambda: node in network.status("clinic")["peers"], "it is back among its peers")
            assert network.propose("hospital") > reached
        finally:
            restored.terminate()
