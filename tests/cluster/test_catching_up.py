"""Nodes that come back with nothing: by blocks where somebody has them, by a snapshot where nobody has, checked by diff."""

from __future__ import annotations

import asyncio
import json
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

from network.cli.main import main as command_line
from node.consensus.journal import Journal
from node.snapshot.snapshot_format import SnapshotFolder, read_manifest
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest, running

BLOCKS_COUNT = 600
KEPT_COUNT = 256
PARALLEL_COUNT = 4


async def make_blocks(network: NetworkUnderTest, until: int, node: str = "node-1") -> None:
    """Let calls become final one after another until the chain has this height."""

    async def work() -> None:
        while (await network.status(node)).get("finalized_height", 0) < until:
            for _ in range(10):
                await network.finalize(node, network.transaction())

    await asyncio.gather(*(work() for _ in range(PARALLEL_COUNT)))


async def wait_caught_up(network: NetworkUnderTest, name: str, timeout_s: float) -> dict[str, Any]:
    """Wait until a node is as far as node-1 is; return its status."""
    deadline = time.monotonic() + timeout_s
    while True:
        own, other = await network.status(name), await network.status("node-1")
        if own.get("ready") and own["finalized_height"] >= other["finalized_height"] - 4:
            return own
        assert time.monotonic() < deadline, (own, network.cluster.latest_messages(name))
        await asyncio.sleep(0.1)


async def run_command(network: NetworkUnderTest, *arguments: str, code: int = 0) -> dict[str, Any]:
    """Run `blockrobot node ...` on the network, as a user does; return its JSON answer."""
    from click.testing import CliRunner

    command = ["node", *arguments, "--dir", str(network.folder), "--json"]
    result = await asyncio.to_thread(CliRunner().invoke, command_line, command)
    assert result.exit_code == code, (arguments, result.output)
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer


async def assert_same(network: NetworkUnderTest, *names: str) -> None:
    for name in names:
        report = await run_command(network, "diff", "node-1", name)
        assert report["same"], report


def forget_chain(network: NetworkUnderTest, name: str) -> None:
    """Make a stopped node one that has just been made: its keys are all it has. (A journal would hold blocks too.)"""
    config = network.cluster.config(name)
    shutil.rmtree(config.ledger_dir)
    config.journal_path.unlink()
    Journal.create(config.journal_path).close()


def log_of(network: NetworkUnderTest, name: str) -> list[dict[str, Any]]:
    text = network.cluster.config(name).log_path.read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


async def test_a_new_node_takes_blocks_where_there_are_some_and_a_snapshot_where_there_are_none(tmp_path: Path) -> None:
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4)) as network:
        await make_blocks(network, BLOCKS_COUNT)
        for name in ("node-1", "node-2"):
            await run_command(network, "prune", name, "--keep", str(KEPT_COUNT))

        network.cluster.stop("node-4")
        forget_chain(network, "node-4")
        loading = asyncio.create_task(make_blocks(network, BLOCKS_COUNT + 150))
        network.cluster.start("node-4")
        status = await wait_caught_up(network, "node-4", 60)
        assert status["earliest_height"] == 0
        await loading
        await wait_caught_up(network, "node-4", FINAL_TIMEOUT_S)
        await assert_same(network, "node-2", "node-3", "node-4")

        network.cluster.stop("node-4")
        forget_chain(network, "node-4")
        pruned = await run_command(network, "prune", "node-3", "--keep", str(KEPT_COUNT))
        assert pruned["earliest_height"] == pruned["height"] - KEPT_COUNT + 1
        assert not pruned["held_back_by_custody"]
        network.cluster.start("node-4")
        status = await wait_caught_up(network, "node-4", 90)
        assert status["earliest_height"] > BLOCKS_COUNT - KEPT_COUNT
        assert "snapshot_ready" in {line["event"] for line in log_of(network, "node-4")}
        await network.finalize("node-4", network.transaction())
        await wait_caught_up(network, "node-4", FINAL_TIMEOUT_S)
        await assert_same(network, "node-2", "node-3", "node-4")


async def test_a_custodian_is_restored_from_a_snapshot_of_another_node_that_runs(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    """Its custody store is new too: it takes the state, then follows blocks."""
    for _ in range(10):
        await network.finalize("node-1", network.transaction())
    made = await run_command(network, "snapshot", "create", "node-3", "--out", str(tmp_path / "snapshot"))
    refused = await run_command(network, "snapshot", "restore", "node-2", str(tmp_path / "snapshot"), code=1)
    assert refused["error"]["code"] == "DATA_DIRECTORY_IN_USE"
    network.cluster.stop("node-2")
    config = network.cluster.config("node-2")
    for folder in (config.ledger_dir, config.custody_dir, config.erase_keys_dir):
        shutil.rmtree(folder)
    restored = await run_command(network, "snapshot", "restore", "node-2", str(tmp_path / "snapshot"))
    assert restored["block_id"] == made["block_id"]
    again = await run_command(network, "snapshot", "restore", "node-2", str(tmp_path / "snapshot"), code=1)
    assert again["error"]["code"] == "SNAPSHOT_OLD"
    network.cluster.start("node-2")
    await network.cluster.wait_ready(["node-2"])
    await network.finalize("node-2", network.transaction())
    status = await wait_caught_up(network, "node-2", FINAL_TIMEOUT_S)
    assert status["earliest_height"] == made["height"]
    deadline = time.monotonic() + FINAL_TIMEOUT_S
    while (status := await network.status("node-2"))["custody_checkpoint"] != status["finalized_height"]:
        assert time.monotonic() < deadline, status
        await asyncio.sleep(0.1)
    events = {line["event"] for line in log_of(network, "node-2")}
    assert "custody_reconciled" in events
    assert "custody_fault" not in events
    await assert_same(network, "node-2")


async def test_a_snapshot_that_was_damaged_or_is_of_another_network_is_refused_by_name(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    await network.finalize("node-1", network.transaction())
    place = tmp_path / "snapshot"
    await run_command(network, "snapshot", "create", "node-1", "--out", str(place))
    network.cluster.stop("node-4")
    forget_chain(network, "node-4")
    chunk = place / "chunk-000001"
    data = chunk.read_bytes()
    chunk.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    damaged = await run_command(network, "snapshot", "restore", "node-4", str(place), code=1)
    chunk.unlink()
    cut = await run_command(network, "snapshot", "restore", "node-4", str(place), code=1)
    assert (damaged["error"]["code"], cut["error"]["code"]) == ("SNAPSHOT_DAMAGED", "SNAPSHOT_TRUNCATED")
    chunk.write_bytes(data)
    other = NetworkUnderTest(tmp_path / "other", nodes=1)
    try:
        foreign = await run_command(other, "snapshot", "restore", "node-1", str(place), code=1)
        assert foreign["error"]["code"] == "SNAPSHOT_OTHER_CHAIN"
    finally:
        await other.close()
    await run_command(network, "snapshot", "restore", "node-4", str(place))
    assert read_manifest(SnapshotFolder(place).manifest()).height > 0
    network.cluster.start("node-4")
    await wait_caught_up(network, "node-4", FINAL_TIMEOUT_S)


@pytest.mark.long
@pytest.mark.timeout(1_800)
async def test_a_node_that_missed_ten_thousand_blocks_catches_up_while_the_chain_goes_on(tmp_path: Path) -> None:
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4)) as network:
        await make_blocks(network, 20)
        network.cluster.stop("node-4")
        old = tmp_path / "ledger.old"
        shutil.copytree(network.cluster.config("node-4").ledger_dir, old)
        network.cluster.start("node-4")
        await make_blocks(network, 10_000)
        for began_with in (old, None):
            network.cluster.stop("node-4")
            forget_chain(network, "node-4")
            if began_with is not None:
                shutil.copytree(began_with, network.cluster.config("node-4").ledger_dir)
            loading = asyncio.create_task(make_blocks(network, 10_000_000))
            started_s = time.monotonic()
            network.cluster.start("node-4")
            await wait_caught_up(network, "node-4", 600)
            assert time.monotonic() - started_s < 300
            loading.cancel()
            await asyncio.gather(loading, return_exceptions=True)
            await wait_caught_up(network, "node-4", 60)
            await assert_same(network, "node-4")
