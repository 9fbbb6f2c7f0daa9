"""A node that ran and can be backed up."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from network.cluster import Cluster
from network.provisioning import node_backup
from network.provisioning.network_layout import create_network
from node.config import NodeConfig, load_config
from node.custody.erase_keys import EraseKeys
from node.node_process import Node
from tests.cluster.network_under_test import find_base_port


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def network_that_ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its one node is a custodian, and has erase keys. Each test has a copy: its files name no place."""
    network = tmp_path_factory.mktemp("ran") / "network"
    create_network(network, nodes=1, organisations=1, base_port=find_base_port(1))
    config = Cluster(network).config("node-1")
    async with Node(config):
        pass
    with EraseKeys(config.erase_keys_dir) as keys:
        keys.allocate(3)
    return network


@pytest.fixture
def config(network_that_ran: Path, tmp_path: Path) -> NodeConfig:
    shutil.copytree(network_that_ran, tmp_path / "network")
    return Cluster(tmp_path / "network").config("node-1")


def changed(config: NodeConfig, old: str, new: str) -> NodeConfig:
    """Its node.toml, with another text in place of one."""
    path = config.data_dir / "node.toml"
    assert path.read_text().count(old) == 1
    path.write_text(path.read_text().replace(old, new))
    return load_config(config.data_dir)


def restored_from(place: Path, tmp_path: Path, **options: Any) -> node_backup.Restored:
    return node_backup.restore(place, tmp_path / "anew", **options)
