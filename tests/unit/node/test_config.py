"""A node's configuration is read whole or refused with the field that is wrong."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from consensus.chain.genesis import genesis_from_json, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from network.provisioning.network_layout import create_network
from node.config import SECTIONS, config_to_toml, load_config, load_genesis, load_key

GOOD = """
[node]
name = "node-1"
[listen]
p2p_port = 7000
api_port = 7001
operator_port = 7002
[keys]
tls_certificate = "keys/tls.crt.pem"
tls_key = "keys/tls.key.pem"
producer = "keys/producer.key"
"""


def _write(folder: Path, text: str) -> Path:
    (folder / "node.toml").write_text(text, encoding="utf-8")
    return folder


def test_paths_are_relative_and_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match=r"^DATA_DIRECTORY_INVALID:"):
        load_config(tmp_path)
    config = load_config(_write(tmp_path, GOOD))
    assert config.producer_key_path == tmp_path / "keys" / "producer.key"
    assert config.custodian_key_path is None
    assert (config.host, config.custody_store, config.log_level) == ("127.0.0.1", "sqlite", "info")
    config = load_config(_write(tmp_path, GOOD + 'custodian = "keys/custodian.key"\n[log]\nlevel = "debug"\n'))
    assert load_config(_write(tmp_path, config_to_toml(config))) == config


def test_paths_elsewhere_and_names_beyond_ascii_are_written_as_they_were_read(tmp_path: Path) -> None:
    elsewhere = GOOD.replace("keys/", "/srv/Schlüssel 🔑/").replace("[node]", '[node]\ngenesis = "/srv/genesis.json"')
    more = '[custody]\nstore = "mongodb://me:\\"@h/db"\nclips = "folder:/mnt/🎞"\n'
    config = load_config(_write(tmp_path, elsewhere + more))
    assert config.producer_key_path == Path("/srv/Schlüssel 🔑/producer.key")
    assert load_config(_write(tmp_path, config_to_toml(config))) == config


@pytest.mark.parametrize(
    ("listen", "api_host", "api_tls"),
    [
        ("", "127.0.0.1", False),
        ('host = "10.0.0.7"', "10.0.0.7", True),
        ('host = "::"', "::", True),
        ('host = "node-1.clinic.example"', "node-1.clinic.example", True),
        ('host = "0.0.0.0"\napi_host = "127.0.0.1"', "127.0.0.1", False),
        ("api_tls = true", "127.0.0.1", True),
        ('host = "10.0.0.7"\napi_tls = false', "10.0.0.7", None),
        ('api_host = "::ffff:10.0.0.7"\napi_tls = false', "::ffff:10.0.0.7", None),
    ],
)
def test_clients_are_served_over_tls_wherever_others_could_listen_in(
    tmp_path: Path, listen: str, api_host: str, api_tls: bool | None
) -> None:
    folder = _write(tmp_path, GOOD.replace("[listen]", f"[listen]\n{listen}"))
    if api_tls is None:
        with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .*TLS"):
            load_config(folder)
        return
    config = load_config(folder)
    assert (config.api_host, config.api_tls) == (api_host, api_tls)
    assert load_config(_write(tmp_path, config_to_toml(config))) == config


def test_figures_and_the_log_go_where_the_file_says(tmp_path: Path) -> None:
    said = '[metrics]\nhost = "10.0.0.7"\nport = 9100\n[log]\nto = "stdout"\n'
    config = load_config(_write(tmp_path, GOOD + said))
    assert (config.metrics_host, config.metrics_port, config.log_to) == ("10.0.0.7", 9100, "stdout")
    assert load_config(_write(tmp_path, config_to_toml(config))) == config


@pytest.mark.parametrize("sandbox", ["on", "require", "off"])
def test_the_sandbox_of_contracts_is_on_unless_the_file_says_otherwise(tmp_path: Path, sandbox: str) -> None:
    assert load_config(_write(tmp_path, GOOD)).contract_sandbox == "on"
    config = load_config(_write(tmp_path, GOOD + f'[contracts]\nsandbox = "{sandbox}"\n'))
    assert config.contract_sandbox == sandbox
    assert load_config(_write(tmp_path, config_to_toml(config))) == config


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ('name = "node-1"', "", "name"),
        ("p2p_port = 7000", 'p2p_port = "7000"', "p2p_port"),
        ("p2p_port = 7000", "p2p_port = 70000", "p2p_port"),
        ("[keys]", '[metrics]\nhost = "10.0.0.7"\nport = 7001\n[keys]', "port twice"),
        ("[keys]", '[metrics]\nhost = "10.0.0.7"\n[keys]', "port"),
        ("[keys]", '[log]\nto = "syslog"\n[keys]', "file, stdout, both"),
        ("p2p_port = 7000", 'p2p_port = 7000\ntrusted_proxies = "10.0.0.1"', "trusted_proxies"),
        ("p2p_port = 7000", "p2p_port = 7000\ntrusted_proxies = [7]", "trusted_proxies"),
        ("p2p_port = 7000", 'p2p_port = 7000\ntrusted_proxies = ["10.0.0.1/8"]', "trusted_proxies"),
        ("api_port = 7001", "api_port = 7000", "twice"),
        ("[listen]", "[listen]\nspeed = 1", "speed"),
        ("[node]", "[nodes]\n[node]", "nodes"),
        ("[keys]", '[log]\nlevel = "loud"\n[keys]', "level"),
        ("[keys]", '[contracts]\nsandbox = "maybe"\n[keys]', "sandbox"),
        ("[node]", "[node", "TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, before: str, after: str, named: str) -> None:
    with pytest.raises(BlockRobotError) as caught:
        load_config(_write(tmp_path, GOOD.replace(before, after)))
    assert caught.value.code == "CONFIGURATION_INVALID"
    assert named in caught.value.detail


def test_a_wrong_key_is_refused_without_a_word_of_it(tmp_path: Path) -> None:
    mine, other = PrivateKey(sha256(b"mine")), PrivateKey(sha256(b"other"))
    path = tmp_path / "producer.key"
    path.write_bytes(mine.secret)
    assert load_key(path, mine.public_key, "producer").public_key == mine.public_key
    with pytest.raises(BlockRobotError) as caught:
        load_key(path, other.public_key, "producer")
    assert caught.value.code == "CONFIGURATION_INVALID"
    assert mine.secret.hex() not in str(caught.value)
    path.write_bytes(b"short")
    with pytest.raises(BlockRobotError):
        load_key(path, mine.public_key, "producer")


def test_a_node_does_not_start_with_a_producer_that_never_proved_its_key(tmp_path: Path) -> None:
    create_network(tmp_path, nodes=2, organisations=1, base_port=20_000)
    config = load_config(tmp_path / "nodes" / "node-1")
    genesis = load_genesis(config)
    first, second = genesis.nodes
    false = msgspec.structs.replace(second, producer_possession=first.producer_possession)
    config.genesis_path.write_text(genesis_to_json(msgspec.structs.replace(genesis, nodes=(first, false))))
    assert genesis_from_json(config.genesis_path.read_text()).nodes[1] == false
    with pytest.raises(BlockRobotError, match=r"GENESIS_INVALID.*'node-2'"):
        load_genesis(config)


def test_a_file_that_is_no_text_is_refused_and_named(tmp_path: Path) -> None:
    create_network(tmp_path, nodes=1, organisations=1, base_port=26_400)
    config = load_config(tmp_path / "nodes" / "node-1")
    config.genesis_path.write_bytes(b'{"network": "caf\xe9"}')
    with pytest.raises(BlockRobotError, match=r"^GENESIS_INVALID: .*UTF-8"):
        load_genesis(config)
    (config.data_dir / "node.toml").write_bytes(b'[node]\nname = "caf\xe9"\n')
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .*UTF-8"):
        load_config(config.data_dir)


def test_the_reference_has_every_field_and_no_other() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "reference" / "node-toml.md"
    found: dict[str, set[str]] = {}
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("## `["):
            fields = found.setdefault(line[5:-2], set())
        elif line.startswith("| `"):
            fields.add(line.split("`")[1])
    assert found == {name: set(fields) for name, fields in SECTIONS.items()}
