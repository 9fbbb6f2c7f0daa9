"""Four organisations on hosts of their own: one is cut off, one moves, a stranger listens; the others go on."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from network.lab.hosts.founded_network import ORGANISATIONS, FoundedNetwork, node_of
from network.lab.hosts.namespaces import Hosts

STORY_MAX_S = 300
COMMAND_MAX_S = 60
WITH_ITS_OWN_AUTHORITY = "lab"
"""Its authority's key is on the visitor's host, and OpenSSL signs there."""
pytestmark = pytest.mark.timeout(STORY_MAX_S)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FoundedNetwork]:
    with Hosts(tmp_path_factory.mktemp("hosts"), [*ORGANISATIONS, "visitor"]) as hosts:
        network = FoundedNetwork(hosts)
        made = ("-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "9")
        usage = ("-addext", "keyUsage=critical,keyCertSign,cRLSign")
        openssl(network, "req", *made, *usage, "-subj", "/CN=Lab Servers CA", "-keyout", "ca.key", "-out", "ca.pem")
        authority = ("--certificate", str(network.visitor.home / "ca.pem"))
        network.found(new={WITH_ITS_OWN_AUTHORITY: authority}, after_init=certify)
        yield network


def openssl(network: FoundedNetwork, *arguments: str) -> None:
    subprocess.run(
        [*network.visitor.prefix, "openssl", *arguments],
        cwd=network.visitor.home,
        capture_output=True,
        timeout=COMMAND_MAX_S,
        check=True,
    )


def certify(network: FoundedNetwork, name: str) -> None:
    if name != WITH_ITS_OWN_AUTHORITY:
        return
    (network.visitor.home / "node.csr").write_bytes((network.data_dir(name) / "node.csr").read_bytes())
    by = ("-CA", "ca.pem", "-CAkey", "ca.key", "-copy_extensions", "copy", "-days", "9")
    openssl(network, "x509", "-req", "-in", "node.csr", *by, "-out", "node.pem")
    network.run(network.hosts[name], "certificate", "install", node_of(name), str(network.visitor.home / "node.pem"))


def test_each_organisation_has_its_say_with_the_key_on_its_own_host(network: FoundedNetwork) -> None:
    heights = [network.propose(name) for name in ORGANISATIONS]
    assert heights == sorted(heights)
    assert len(set(heights)) == len(heights)
    keys = {name: list(network.hosts[name].home.rglob("admin.key")) for name in ORGANISATIONS}
    assert [len(found) for found in keys.values()] == [1] * 4


def test_no_key_of_an_authority_that_is_elsewhere_came_to_its_nodes_host(network: FoundedNetwork) -> None:
    keys = {name: list(network.hosts[name].home.rglob("ca.key.pem")) for name in ORGANISATIONS}
    assert [len(keys[name]) for name in ORGANISATIONS] == [name != WITH_ITS_OWN_AUTHORITY for name in ORGANISATIONS]


def test_each_host_sees_what_the_nodes_of_the_others_prove(network: FoundedNetwork) -> None:
    reached = network.propose("lab")
    for name in ("clinic", "lab"):
        found = network.elsewhere(name)
        assert found.keys() == {node_of(other) for other in ORGANISATIONS if other != name}
        assert [row["problem"] for row in found.values()] == [None] * len(found)
        heights = sorted(row["finalized_height"] for row in found.values())
        assert heights[0] > 0
        assert heights[-1] >= reached
    doctor = network.ask(network.hosts["clinic"], "doctor")
    assert {row["name"] for row in doctor["elsewhere"]} == {node_of(name) for name in ORGANISATIONS if name != "clinic"}
    assert not [row for row in doctor["findings"] if row["code"].startswith("REMOTE_")]
    custody = network.ask(network.hosts["clinic"], "custody", "status")
    assert len(custody["elsewhere"]) == len(ORGANISATIONS) - 1


def test_a_host_without_a_node_sees_them_all_by_the_genesis_file_alone(network: FoundedNetwork) -> None:
    visitor, genesis = network.visitor, network.visitor.home / "from-the-hospital" / "genesis.json"
    assert "no network" in network.run(visitor, "status", fails=True)
    genesis.parent.mkdir()
    genesis.write_bytes(network.genesis_path.read_bytes())
    seen = network.ask(visitor, "status", "--genesis", str(genesis))
    assert (seen["ok"], seen["nodes"]) == (True, [])
    assert {row["name"] for row in seen["elsewhere"]} == {node_of(name) for name in ORGANISATIONS}
    assert [row["problem"] for row in seen["elsewhere"]] == [None] * len(ORGANISATIONS)


PASSING_ON = """
import asyncio, sys

async def pass_on(reader, writer):
    while data := await reader.read(65536):
        writer.write(data)
    writer.close()

async def serve(reader, writer):
    there, back = await asyncio.open_connection(sys.argv[2], 7273)
    await asyncio.gather(pass_on(reader, back), pass_on(there, writer), return_exceptions=True)

async def main():
    server = await asyncio.start_server(serve, sys.argv[1], 9443)
    print("ready", flush=True)
    await server.serve_forever()

asyncio.run(main())
"""


def test_a_node_is_reached_through_a_proxy_that_no_certificate_names(network: FoundedNetwork) -> None:
    proxy, lab, other = f"https://{network.visitor.address}:9443", node_of("lab"), node_of("university")
    command = [*network.visitor.prefix, sys.executable, "-c", PASSING_ON, network.visitor.address]
    with subprocess.Popen([*command, network.hosts["lab"].address], stdout=subprocess.PIPE) as passing_on:
        try:
            assert passing_on.stdout is not None
            assert passing_on.stdout.readline() == b"ready\n"
            found = network.elsewhere("clinic", "--node", proxy)
            assert (found[lab]["api_url"], found[lab]["problem"]) == (proxy, None)
            found = network.elsewhere("clinic", "--node", f"{other}={proxy}")
            assert found[other]["api_url"] != proxy, "who answers there is another node"
            assert found[other]["problem"] is None
            listed = network.ask(network.hosts["clinic"], "--node", proxy, "org", "list")
            assert len(listed["nodes"]) == len(ORGANISATIONS)
        finally:
            passing_on.terminate()


def test_a_host_that_is_cut_off_is_told_to_be_unreachable(network: FoundedNetwork) -> None:
    network.hosts["lab"].cut(off=True)
    network.wait(lambda: node_of("lab") not in network.status("clinic")["peers"], "the laboratory is missed")
    gone = network.elsewhere("clinic")[node_of("lab")]
    assert (gone["finalized_height"], gone["problem"]["code"]) == (None, "NODE_UNREACHABLE")
    network.hosts["lab"].cut(off=False)
    network.wait(lambda: len(network.status("lab")["peers"]) == 3, "the laboratory is back")
    assert network.propose("lab") > 0


def test_a_stranger_on_the_network_reads_nothing_in_plain_text(network: FoundedNetwork) -> None:
    url = f"http://{network.hosts['hospital'].address}:7273/v1/genesis"
    done = subprocess.run([*network.visitor.prefix, "curl", "-sS", "-m", "5", url], capture_output=True, check=False)
    assert done.returncode != 0
    assert done.stdout == b""


def test_a_node_that_moves_is_found_at_its_new_address(network: FoundedNetwork) -> None:
    host, node = network.hosts["university"], node_of("university")
    old, new = host.address, "10.77.0.99"
    host.renumber(new)
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
