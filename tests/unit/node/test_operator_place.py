"""The operator's listener asks nobody for a password, so it never leaves the machine, wherever the node listens."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest

import node.node_process as service
from network.cluster import Cluster, fetch_status
from network.provisioning.network_layout import create_network
from node.node_process import Node
from node.p2p.connection_acceptor import bind_listener
from tests.cluster.network_under_test import find_base_port


async def test_the_operator_listens_on_loopback_though_the_node_listens_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound: dict[int, str] = {}

    def watched(host: str, port: int) -> socket.socket:
        bound[port] = host
        return bind_listener(host, port)

    monkeypatch.setattr(service, "bind_listener", watched)
    create_network(tmp_path, nodes=1, organisations=1, base_port=find_base_port(1))
    everywhere = "0.0.0.0"
    config = replace(Cluster(tmp_path).config("node-1"), api_host=everywhere)
    async with Node(config), aiohttp.ClientSession() as session:
        status = await fetch_status(session, config)
    assert bound == {config.api_port: everywhere, config.operator_port: "127.0.0.1"}
    assert status is not None
    assert status["name"] == "node-1"
