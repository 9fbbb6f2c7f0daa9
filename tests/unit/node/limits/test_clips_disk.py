"""A custodian whose clips are on a disk of their own keeps its reserve there too."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from network.cluster import Cluster
from network.provisioning.network_layout import create_network
from node.clips_place import read_place
from node.directory.node_directory import Directory, content_of_genesis
from node.limits.disk_reserve import MIB_BYTES
from node.node_process import Node


async def test_a_nodes_reserve_is_reached_when_the_clips_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=20_000)
    config, clips = Cluster(tmp_path / "network").config("node-1"), tmp_path / "clips"
    node = Node(replace(config, clips=read_place(f"folder:{clips}", config.data_dir)))
    free_mib = {config.data_dir: 2 * config.custody_reserve_mib, clips: 2 * config.custody_reserve_mib}
    monkeypatch.setattr(os, "statvfs", lambda folder: SimpleNamespace(f_bavail=free_mib[folder], f_frsize=MIB_BYTES))
    async with node._stack:
        place = await node._open_custody(Directory(content_of_genesis(node.genesis)))
        assert place is not None
        assert place.reserve is not None
        assert not place.reserve.is_reached
        free_mib[clips] = 0
        assert place.reserve.is_reached
