"""`node init` makes a node of one network, whatever other network lies on the machine."""

from __future__ import annotations

import json
import subprocess
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner, Result
from cryptography import x509

from consensus.chain.genesis import Genesis
from network.cli.governance.org_commands import org
from network.cli.node.node_setup_commands import init
from network.cluster import Cluster
from network.provisioning.certificate_authority import certified_hosts
from network.provisioning.network_layout import PORTS_PER_NODE, create_network
from network.provisioning.new_node import NODE_ENTRY_FILE
from network.provisioning.node_joining import of_chain
from node.config import load_config, load_genesis
from node.directory.directory_file import DIRECTORY_FILE
from pages.listening import is_loopback, open_listener

HOME_PORT, OTHER_PORT = 21_000, 22_000


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A network for trying things out, in the home folder: it may be broken on purpose."""
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    create_network(tmp_path / "network", nodes=2, organisations=2, base_port=HOME_PORT, faults=True)
    return tmp_path / "network"


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """The network that matters, with organisations of the same names."""
    create_network(tmp_path / "real", nodes=2, organisations=2, base_port=OTHER_PORT)
    return tmp_path / "real"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(init, list(arguments))


def genesis_of(folder: Path) -> Genesis:
    return Cluster(folder).genesis


def test_the_network_in_the_home_folder_says_nothing_of_another_one(home: Path, other: Path, tmp_path: Path) -> None:
    place = tmp_path / "srv"
    authority = other / "organisations" / "hospital"
    said = run(
        *("node-3", "--organisation", "hospital", "--genesis", str(other / "genesis.json"), "--json"),
        *("--data-dir", str(place), "--authority", str(authority)),
    )
    assert said.exit_code == 0, said.output
    config = load_config(place)
    assert load_genesis(config).chain_id == genesis_of(other).chain_id
    assert not config.faults_enabled
    assert not (place / DIRECTORY_FILE).exists()


def test_a_node_of_another_network_is_not_put_into_the_home_folder(home: Path, other: Path) -> None:
    said = run("node-3", "--organisation", "hospital", "--genesis", str(other / "genesis.json"))
    assert said.exit_code == 2
    assert "another network" in said.stderr
    assert Cluster(home).names == ["node-1", "node-2"]


def test_only_nodes_of_one_chain_are_asked_who_is_there(home: Path, other: Path) -> None:
    ours, theirs = (list(Cluster(folder).configs.values()) for folder in (home, other))
    theirs[1].genesis_path.write_text("no genesis", "utf-8")
    assert of_chain([*ours, *theirs], genesis_of(other).chain_id) == theirs[:1]
    theirs[0].genesis_path.unlink()
    assert of_chain([*ours, *theirs], genesis_of(home).chain_id) == ours


def test_an_organisation_that_was_not_let_in_is_told_which_step_is_missing(home: Path, tmp_path: Path) -> None:
    made = CliRunner().invoke(org, ["new", "clinic"])
    assert "found a network: blockrobot node init NODE --founding --organisation clinic" in made.output
    assert "blockrobot org propose add-org --from organisation-entry.json" in made.output
    said = " ".join(run("node-3", "--organisation", "clinic").stderr.split())
    assert "ORGANISATION_NOT_ADMITTED" in said
    assert "org propose add-org" in said
    assert "--directory" in said
    assert not (home / "nodes" / "node-3").exists()


def test_a_host_that_knows_no_network_yet_is_told_where_its_genesis_file_comes_from(
    home: Path, other: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path / "new host"))
    network = tmp_path / "new host" / "network"
    options = ("--genesis", str(other / "genesis.json"), "--authority", str(other / "organisations" / "hospital"))
    made = json.loads(run("node-3", "--organisation", "hospital", *options, "--json").stdout)
    listed = CliRunner().invoke(org, ["list"])
    assert f"cp {network}/nodes/node-3/genesis.json" in " ".join(listed.stderr.split())
    typed = made["next_steps"][0].split("   ")[0]
    subprocess.run(typed, shell=True, check=True)
    assert genesis_of(network).chain_id == genesis_of(other).chain_id
    again = json.loads(run("node-4", "--organisation", "hospital", *options, "--json").stdout)
    assert again["next_steps"][0].startswith("blockrobot org propose add-node")


def test_faults_are_allowed_only_if_one_says_so(home: Path) -> None:
    for name, flags in (("node-3", ()), ("node-4", ("--faults",))):
        assert run(name, "--organisation", "hospital", *flags).exit_code == 0
        assert load_config(home / "nodes" / name).faults_enabled == bool(flags)
    assert load_config(home / "nodes" / "node-3").p2p_port == HOME_PORT + 2 * PORTS_PER_NODE


@pytest.mark.parametrize(
    ("arguments", "url"),
    [
        ((), "http://127.0.0.1:21501"),
        (("--bind", "::1"), "http://[::1]:21501"),
        (("--bind", "10.0.0.7"), "https://10.0.0.7:21501"),
        (("--bind", "fd00::7"), "https://[fd00::7]:21501"),
        (("--bind", "0.0.0.0", "--advertise", "node-3.clinic.example"), "https://node-3.clinic.example:21501"),
        (("--bind", "::", "--advertise", "[fd00::7]:443"), "https://[fd00::7]:444"),
        (("--bind", "::", "--advertise", "[FD00:0::7]:00443"), "https://[fd00::7]:444"),
        (("--bind", "0.0.0.0", "--advertise", "Node-3.Example.:442"), "https://node-3.example"),
        (("--bind", "10.0.0.7", "--api-url", "https://Node-3.example.:0443/"), "https://node-3.example"),
        (("--bind", "10.0.0.7", "--api-url", "https://node-3.example/api"), None),
        (("--bind", "10.0.0.7", "--api-url", "https://node-3.example?a"), None),
        (("--bind", "10.0.0.7", "--api-url", "https://node-3.example#a"), None),
        (("--bind", "10.0.0.7", "--api-url", "https://me:secret@node-3.example"), None),
        (("--bind", "10.0.0.7", "--api-url", "https://node-3..example"), None),
        (("--bind", "10.0.0.7:21500"), None),
        (("--bind", "node-3.example"), None),
        (("--bind", "10.0.0.999", "--advertise", "10.0.0.7"), None),
        (("--bind", "10.0.0.7", "--api-bind", "127.0.0.1:80"), None),
        (("--bind", "10.0.0.7", "--api-bind", "somewhere"), None),
        (("--bind", "10.0.0.7", "--api-url", "https://node-3.clinic.example"), "https://node-3.clinic.example"),
        (("--bind", "10.0.0.7", "--api-url", "http://127.0.0.1:9000"), "http://127.0.0.1:9000"),
        (("--bind", "0.0.0.0"), None),
        (("--bind", "::"), None),
        (("--bind", "0.0.0.0", "--advertise", "10.0.0.7:70000"), None),
        (("--bind", "0.0.0.0", "--advertise", "user@node-3:443"), None),
        (("--bind", "0.0.0.0", "--advertise", "https://node-3:443"), None),
        (("--api-url", "http://node-3.clinic.example"), None),
        (("--api-url", "node-3.clinic.example"), None),
    ],
)
def test_a_node_is_entered_only_where_clients_would_talk_to_it(
    home: Path, arguments: tuple[str, ...], url: str | None
) -> None:
    place = home / "nodes" / "node-3"
    said = run("node-3", "--organisation", "hospital", "--base-port", "21500", *arguments)
    if url is None:
        assert "CONFIGURATION_INVALID" in said.stderr or "NODE_ADDRESS_UNUSABLE" in said.stderr
        assert "secret" not in said.stderr
        assert not place.exists()
    else:
        assert said.exit_code == 0, said.output
        assert json.loads((place / NODE_ENTRY_FILE).read_text("utf-8"))["api_url"] == url
        config, reached = load_config(place), urlsplit(url).hostname or ""
        assert config.api_tls == (not is_loopback(config.api_host))
        assert reached in certified_hosts(x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes()))


def test_a_node_takes_no_ports_of_one_that_lies_beside_it(home: Path) -> None:
    said = run("node-3", "--organisation", "hospital", "--base-port", str(HOME_PORT + PORTS_PER_NODE - 1))
    assert "PORT_IN_USE" in said.stderr
    assert f"127.0.0.1:{HOME_PORT + PORTS_PER_NODE} is for node-2" in " ".join(said.stderr.split())
    assert not (home / "nodes" / "node-3").exists()
    everywhere = ("--bind", "0.0.0.0", "--advertise", "ward.example", "--base-port", str(HOME_PORT))
    assert "is for node-1" in " ".join(run("node-3", "--organisation", "hospital", *everywhere).stderr.split())
    port = str(HOME_PORT + PORTS_PER_NODE + 1)
    made = run("node-3", "--organisation", "hospital", "--bind", "127.0.0.9", "--base-port", port)
    assert made.exit_code == 0, "at another address the ports are free"


def test_an_address_that_is_not_here_and_a_port_that_is_taken_are_warned_of(home: Path) -> None:
    """The machine may get the address later, and the program be gone until the node starts."""
    taken = open_listener("127.0.0.1", 0)
    port = taken.getsockname()[1]
    with closing(taken):
        free = run("node-3", "--organisation", "hospital", "--json")
        said = run("node-4", "--organisation", "hospital", "--bind", "203.0.113.5", "--json")
        beside = run("node-5", "--organisation", "hospital", "--base-port", str(port))
    assert json.loads(free.stdout)["warnings"] == []
    (warning,) = json.loads(said.stdout)["warnings"]
    assert (warning["code"], warning["detail"]) == ("ADDRESS_NOT_HERE", "203.0.113.5 is no address of this machine.")
    assert f"warning PORT_IN_USE: Another program already listens on 127.0.0.1:{port}." in beside.output
    assert load_config(home / "nodes" / "node-4").host == "203.0.113.5"


def _proposals(*arguments: str) -> list[str]:
    """The next steps that propose something, as they would be typed."""
    steps = json.loads(run(*arguments, "--json").stdout)["next_steps"]
    typed = [step.split("   ")[0] for step in steps]
    return [step for step in typed if " propose " in step]


def test_who_is_to_propose_the_newcomer_is_somebody_whose_key_is_here(home: Path, other: Path, tmp_path: Path) -> None:
    """An organisation's admin may sit elsewhere: then its name would only lead to a refusal."""
    own = _proposals("node-3", "--organisation", "university")
    assert [step.endswith("--as university") for step in own] == [True, True]
    elsewhere = tmp_path / "else where"
    (home / "organisations" / "university").rename(elsewhere)
    for name, speaker in (("node-4", f"--key '{elsewhere / 'admin.key'}'"), ("node-5", "--as ORG")):
        said = _proposals(name, "--organisation", "university", "--authority", str(elsewhere))
        assert [step.endswith(speaker) for step in said] == [True, True]
        (elsewhere / "admin.key").unlink(missing_ok=True)
    foreign = ("--genesis", str(other / "genesis.json"), "--data-dir", str(tmp_path / "srv"))
    authority = other / "organisations" / "hospital"
    (authority / "admin.key").unlink()
    said = _proposals("node-6", "--organisation", "hospital", "--authority", str(authority), *foreign)
    assert [step.endswith("--as ORG") for step in said] == [True, True], "the hospital here is another one"
