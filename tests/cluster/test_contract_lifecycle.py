"""A contract comes to a running network, is upgraded while a node is away, rests and returns; all nodes agree on it."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path
from typing import Any

from contracts.lifecycle.registry import read_source
from tests.cluster.commands import blockrobot, must
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest
from tests.cluster.test_catching_up import assert_same, make_blocks, run_command, wait_caught_up
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2

DELAY_BLOCKS = 40


async def decide(network: NetworkUnderTest, *arguments: str) -> int:
    """One organisation proposes, the other approves; return the height at which the contract changes."""
    opened = await must(network, "contract", *arguments, "--as", "hospital")
    proposal = opened["proposal"]["id"]
    decided = await must(network, "contract", "approve", proposal[:12], "--as", "university", "--no-wait")
    return int(decided["due_height"])


async def enter(network: NetworkUnderTest, node: str, *arguments: Any) -> dict[str, Any]:
    """Call `visitors.enter`; return the receipt."""
    transaction = network.transaction(contract="visitors", entry="enter", arguments=list(arguments))
    return dict((await network.finalize(node, transaction))["receipt"])


async def refusal(network: NetworkUnderTest, node: str, *arguments: Any) -> dict[str, Any]:
    """The problem with which a node refuses a call of `visitors.enter` at once."""
    transaction = network.transaction(contract="visitors", entry="enter", arguments=list(arguments))
    (answer,) = await network.submit(node, [transaction])
    assert answer["status"] == "rejected"
    return dict(answer["error"])


async def inside(network: NetworkUnderTest) -> Any:
    return (await must(network, "contract", "query", "visitors", "inside", "--source", str(network.folder / "now.py")))[
        "result"
    ]


def write_source(network: NetworkUnderTest, source: str) -> str:
    path = network.folder / "now.py"
    path.write_text(source, encoding="utf-8")
    return str(path)


async def test_a_contract_is_deployed_upgraded_disabled_and_rolled_back_under_load(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    load = asyncio.create_task(make_blocks(network, 1_000_000))
    try:
        height = await decide(network, "propose", write_source(network, VISITORS), "--name", "visitors")
        await network.wait_height("node-1", height)
        assert (await enter(network, "node-2", "Ada"))["ok"]

        network.cluster.kill("node-4")
        upgrade = ("propose", write_source(network, VISITORS_2), "--name", "visitors", "--delay", str(DELAY_BLOCKS))
        height = await decide(network, *upgrade)
        await network.wait_height("node-1", height)
        assert (await enter(network, "node-1", "Bob", 2))["ok"]
        assert await inside(network) == [["Ada", 0], ["Bob", 2]]
        network.cluster.start("node-4")
        await wait_caught_up(network, "node-4", 60)
        assert (await enter(network, "node-4", "Cy", 3))["ok"]
        outdated = await refusal(network, "node-4", "Dee")
        assert (outdated["code"], "Version 1 took (str)" in outdated["detail"]) == ("CONTRACT_CALL_OUTDATED", True)

        height = await decide(network, "disable", "visitors")
        await network.wait_height("node-3", height)
        assert (await refusal(network, "node-3", "Dee", 1))["code"] == "CONTRACT_DISABLED"
        await network.wait_height("node-1", await decide(network, "activate", "visitors", "1"))
        assert (await enter(network, "node-1", "Dee"))["ok"]
    finally:
        load.cancel()
        await asyncio.gather(load, return_exceptions=True)
    for name in ("node-2", "node-3", "node-4"):
        await wait_caught_up(network, name, FINAL_TIMEOUT_S)
    await assert_same(network, "node-2", "node-3", "node-4")

    network.cluster.stop_all()
    network.cluster.start_all()
    await network.cluster.wait_ready()
    assert (await enter(network, "node-2", "Eve"))["ok"]
    shown = await must(network, "contract", "show", "visitors")
    assert (shown["version"], shown["status"], shown["source"]) == (1, "active", VISITORS)

    await run_command(network, "snapshot", "create", "node-3", "--out", str(tmp_path / "snapshot"))
    network.cluster.stop("node-4")
    config = network.cluster.config("node-4")
    shutil.rmtree(config.ledger_dir)
    for folder in (config.custody_dir, config.erase_keys_dir):
        shutil.rmtree(folder, ignore_errors=True)
    await run_command(network, "snapshot", "restore", "node-4", str(tmp_path / "snapshot"))
    network.cluster.start("node-4")
    await wait_caught_up(network, "node-4", 60)
    assert (await enter(network, "node-4", "Fay"))["ok"]
    await wait_caught_up(network, "node-4", FINAL_TIMEOUT_S)
    await assert_same(network, "node-4")


async def test_settings_are_upgraded_on_running_nodes_and_go_back_to_what_shipped(network: NetworkUnderTest) -> None:
    """Also after a restart, when nodes began with the later version and never had the first one compiled."""
    narrower = read_source("settings").replace('"blocks_per_turn": [1, 100]', '"blocks_per_turn": [1, 2]')
    proposal = ("settings", "propose", "blocks_per_turn", "3", "--as", "hospital")
    height = await decide(network, "propose", write_source(network, narrower), "--name", "settings")
    load = asyncio.create_task(make_blocks(network, height + 1))
    await asyncio.wait_for(load, 60)
    assert (await blockrobot(network, *proposal))[1]["error"]["code"] == "GOVERNANCE_SETTING_REFUSED"

    network.cluster.stop_all()
    network.cluster.start_all()
    await network.cluster.wait_ready()
    height = await decide(network, "activate", "settings", "1")
    await asyncio.wait_for(make_blocks(network, height + 1), 60)
    proposed = await must(network, *proposal)
    await must(network, "settings", "approve", proposed["proposal"]["id"][:12], "--as", "university")
    assert (await must(network, "settings", "list"))["settings"]["blocks_per_turn"] == 3
    for name in ("node-2", "node-3", "node-4"):
        await wait_caught_up(network, name, FINAL_TIMEOUT_S)
    await assert_same(network, "node-2", "node-3", "node-4")
