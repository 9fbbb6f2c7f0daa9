"""A lying node is the honest node, with the honest node's own name and key, whenever it joined."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import network.byzantine.process as process
from consensus.errors import BlockRobotError
from network.byzantine.process import ByzantineNode
from network.provisioning.network_layout import create_network
from network.provisioning.new_node import NewNode, new_key
from network.provisioning.node_certificates import get_authority
from network.provisioning.node_joining import init_node
from node.config import NodeConfig, load_config
from node.directory.node_directory import content_of_genesis
from tests.cluster.network_under_test import find_base_port


@pytest.fixture
def newcomer(tmp_path: Path) -> NodeConfig:
    """A node that the genesis file does not name."""
    base_port = find_base_port(3)
    genesis = create_network(tmp_path, nodes=2, organisations=1, base_port=base_port, faults=True)
    place = tmp_path / "nodes" / "node-3"
    wanted = NewNode("node-3", "hospital", "127.0.0.1", base_port + 20, faults=True)
    init_node(place, wanted, genesis, get_authority(tmp_path, "hospital"), content_of_genesis(genesis))
    return load_config(place)


async def test_a_node_that_joined_later_starts_as_a_liar(newcomer: NodeConfig) -> None:
    async with ByzantineNode(newcomer, "garbage", 7) as node:
        assert node.describe()["name"] == "node-3"


async def test_the_liar_signs_with_the_key_that_the_node_has_now(
    newcomer: NodeConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[Any] = []
    monkeypatch.setattr(process, "EngineView", lambda *_: None)

    def make(_: str, *, key: Any, **__: Any) -> _Idle:
        used.append(key)
        return _Idle()

    monkeypatch.setattr(process, "make_behaviour", make)
    wrap: Any = ByzantineNode(newcomer, "equivocate", 7)._wrap_outbox
    fresh = new_key()
    wrap(None, SimpleNamespace(engine=None, network=None, surroundings=SimpleNamespace(key=fresh)))
    assert used == [fresh]
    with pytest.raises(BlockRobotError, match="FAULT_INVALID"):
        wrap(None, SimpleNamespace(engine=None, network=None, surroundings=SimpleNamespace(key=None)))


class _Idle:
    def tick(self) -> None:
        """Tell no lies."""
