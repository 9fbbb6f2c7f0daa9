"""A node that cannot start says why in one sentence and what to do, and harms nobody."""

from __future__ import annotations

import asyncio
import socket
import sys
from pathlib import Path

import pytest

from network.provisioning.network_layout import create_network
from tests.cluster.network_under_test import NetworkUnderTest, find_base_port, running


async def _run_node(data_dir: Path) -> tuple[int, str]:
    """Run a node process to its end; return its exit code and all that it printed."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "node.main",
        "--data-dir",
        str(data_dir),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    output, _ = await asyncio.wait_for(process.communicate(), 60)
    return process.returncode or 0, output.decode()


def _assert_plain(output: str, code: str) -> None:
    assert output.startswith(f"{code}: ")
    assert len(output.strip().splitlines()) == 1
    assert "Traceback" not in output


@pytest.mark.smoke
async def test_a_second_node_on_a_data_directory_in_use_is_refused_and_the_first_goes_on(
    network: NetworkUnderTest,
) -> None:
    code, output = await _run_node(network.cluster.config("node-1").data_dir)
    assert code == 1
    _assert_plain(output, "DATA_DIRECTORY_IN_USE")
    await network.finalize("node-1", network.transaction())


async def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    base_port = find_base_port(1)
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=base_port)
    for offset in range(3):
        with socket.socket() as other:
            other.bind(("127.0.0.1", base_port + offset))
            other.listen()
            code, output = await _run_node(tmp_path / "network" / "nodes" / "node-1")
        assert code == 1
        _assert_plain(output, "PORT_IN_USE")
        assert str(base_port + offset) in output


async def test_a_missing_journal_keeps_a_node_from_starting(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=find_base_port(1))
    data_dir = tmp_path / "network" / "nodes" / "node-1"
    (data_dir / "journal" / "votes.journal").unlink()
    code, output = await _run_node(data_dir)
    assert code == 1
    _assert_plain(output, "JOURNAL_MISSING")
    assert "--restored" in output


async def test_a_key_that_is_not_the_nodes_own_is_refused_without_showing_it(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=2, organisations=1, base_port=find_base_port(2))
    first, second = (tmp_path / "network" / "nodes" / name / "keys" / "producer.key" for name in ("node-1", "node-2"))
    first.chmod(0o600)
    first.write_bytes(second.read_bytes())
    code, output = await _run_node(first.parent.parent)
    assert code == 1
    _assert_plain(output, "CONFIGURATION_INVALID")
    assert second.read_bytes().hex() not in output


async def test_a_directory_without_a_node_is_refused(tmp_path: Path) -> None:
    code, output = await _run_node(tmp_path)
    assert code == 1
    _assert_plain(output, "DATA_DIRECTORY_INVALID")


@pytest.mark.smoke
async def test_a_node_alone_is_a_network(tmp_path: Path) -> None:
    async with running(NetworkUnderTest(tmp_path / "network", nodes=1)) as network:
        assert (await network.finalize("node-1", network.transaction()))["status"] == "finalized"
