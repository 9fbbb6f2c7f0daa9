"""A node that joins has a data directory of its own, and an entry that holds no secret."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from consensus.chain.genesis import POSSESSION_TAG, Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import verify
from network.cluster import Cluster
from network.provisioning.exchange_files import read_node_entry
from network.provisioning.network_layout import PORTS_PER_NODE, create_network
from network.provisioning.new_node import NODE_ENTRY_FILE, Founder, NewNode, create_node, new_key
from network.provisioning.node_certificates import get_authority, now_ms, read_report
from network.provisioning.node_joining import (
    init_node,
    newest_directory,
    next_base_port,
    organisation_of,
)
from node.config import load_config, load_genesis
from node.consensus.journal import count_records
from node.directory.node_directory import content_of_genesis

BASE_PORT = 20_000


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "network"


@pytest.fixture
def genesis(folder: Path) -> Genesis:
    return create_network(folder, nodes=2, organisations=2, base_port=BASE_PORT)


def newcomer(name: str = "node-3", organisation: str = "hospital", **changes: object) -> NewNode:
    return NewNode(name, organisation, "127.0.0.1", BASE_PORT + 20, **changes)  # type: ignore[arg-type]


def test_a_newcomer_can_be_opened_as_any_node(folder: Path, genesis: Genesis) -> None:
    place = folder / "nodes" / "node-3"
    directory = content_of_genesis(genesis)
    entry = init_node(place, newcomer(is_custodian=True), genesis, get_authority(folder, "hospital"), directory)
    config = load_config(place)
    assert load_genesis(config).chain_id == genesis.chain_id
    assert (config.name, config.organisation, config.p2p_port) == ("node-3", "hospital", BASE_PORT + 20)
    assert count_records(config.journal_path) == 0
    assert read_report(config).state(now_ms()) == "valid"
    assert config.custodian_key_path is not None
    assert len(entry.custodian_key) == 33
    assert Cluster(folder).names == ["node-1", "node-2", "node-3"]


def test_its_entry_proves_its_key_and_holds_no_secret(folder: Path, genesis: Genesis) -> None:
    place = folder / "nodes" / "node-3"
    init_node(place, newcomer(), genesis, get_authority(folder, "hospital"), content_of_genesis(genesis))
    arguments = read_node_entry(place / NODE_ENTRY_FILE)
    assert arguments["custodian_key"] == b""
    assert verify(arguments["producer_key"], POSSESSION_TAG, arguments["producer_possession"], b"node-3")
    secret = (place / "keys" / "producer.key").read_bytes().hex()
    assert secret not in (place / NODE_ENTRY_FILE).read_text()
    assert json.loads((place / NODE_ENTRY_FILE).read_text())["api_url"] == f"http://127.0.0.1:{BASE_PORT + 21}"


@pytest.mark.parametrize(
    ("wanted", "code"),
    [
        (newcomer(name="node-1"), "NODE_EXISTS"),
        (newcomer(organisation="clinic"), "ORGANISATION_NOT_ADMITTED"),
        (newcomer(name="Node 3"), "CONFIGURATION_INVALID"),
        (newcomer(name="n" * 41), "CONFIGURATION_INVALID"),
    ],
)
def test_what_the_network_would_refuse_is_refused_at_once(
    folder: Path, genesis: Genesis, wanted: NewNode, code: str
) -> None:
    place = folder / "nodes" / "new"
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        init_node(place, wanted, genesis, get_authority(folder, "hospital"), content_of_genesis(genesis))
    assert not place.exists()


def test_a_data_directory_is_never_overwritten_and_ports_are_those_behind_all_known_ones(
    folder: Path, genesis: Genesis
) -> None:
    place = folder / "nodes" / "node-3"
    place.mkdir()
    with pytest.raises(BlockRobotError, match="NODE_EXISTS"):
        init_node(place, newcomer(), genesis, get_authority(folder, "hospital"), content_of_genesis(genesis))
    assert list(place.iterdir()) == []
    configs = list(Cluster(folder).configs.values())
    assert next_base_port(content_of_genesis(genesis), configs) == BASE_PORT + 2 * PORTS_PER_NODE


def test_a_folder_beside_a_new_node_stays_whatever_its_name_is(folder: Path, genesis: Genesis, tmp_path: Path) -> None:
    place, mine = tmp_path / "far" / "n9", tmp_path / "far" / ".n9.new" / "mine.txt"
    authority, directory = get_authority(folder, "hospital"), content_of_genesis(genesis)
    mine.parent.mkdir(parents=True)
    mine.write_text("mine", encoding="utf-8")
    init_node(place, newcomer(), genesis, authority, directory)
    assert load_config(place).name == "node-3"
    assert mine.read_text(encoding="utf-8") == "mine"
    with pytest.raises(BlockRobotError, match="PORT_IN_USE"):
        init_node(place.with_name("n10"), newcomer(store="neither"), genesis, authority, directory)
    (place / "node.toml").write_text("of another version", "utf-8")
    with pytest.raises(BlockRobotError, match="The store is"):
        init_node(place.with_name("n10"), newcomer(store="neither"), genesis, authority, directory)
    assert sorted(path.name for path in place.parent.iterdir()) == [".n9.new", "n9"]


def test_nodes_of_one_name_share_no_database_on_a_server(folder: Path, genesis: Genesis, tmp_path: Path) -> None:
    """Networks that parties found are all called blockrobot, unless somebody says otherwise."""
    authority, stores = get_authority(folder, "hospital"), set()
    new = newcomer(is_custodian=True, store="mongodb://db.example:27017")
    for number, founder in enumerate((None, Founder(new_key(), 1))):
        place = tmp_path / str(number) / "node-3"
        if founder is None:
            init_node(place, new, genesis, authority, content_of_genesis(genesis))
        else:
            create_node(place, new, authority, founder=founder)
        stores.add(load_config(place).custody_store)
    assert len(stores) == 2
    assert all(re.fullmatch(r"mongodb://db\.example:27017/blockrobot-[0-9a-f]{8}-node-3", store) for store in stores)


def test_whose_a_node_is_and_who_is_there_stands_in_genesis_or_its_own_file(folder: Path, genesis: Genesis) -> None:
    configs = list(Cluster(folder).configs.values())
    assert [organisation_of(config, configs) for config in configs] == ["hospital", "university"]
    place = folder / "nodes" / "node-3"
    init_node(place, newcomer(), genesis, get_authority(folder, "hospital"), content_of_genesis(genesis))
    assert organisation_of(load_config(place), []) == "hospital"
    assert newest_directory(genesis, Cluster(folder).configs.values()) == content_of_genesis(genesis)
