"""Following events from outside: nodes restart, followers are killed, and every event still comes once, in order."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

from clients.sdk.network_client import NetworkClient
from consensus.primitives.keys import PrivateKey
from tests.cluster.commands import blockrobot, must
from tests.cluster.network_under_test import NetworkUnderTest

TIMEOUT_S = 60


async def start_follower(network: NetworkUnderTest, out: Path) -> Process:
    """Start `contract events --follow`, which writes what it hears to a file."""
    command = ["contract", "events", "--follow", "--name", "proposed", "--out", str(out), "--as", "hospital"]
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "network.cli.main", *command, "--dir", str(network.folder)
    )


def heard(out: Path) -> list[dict[str, Any]]:
    lines = out.read_bytes().splitlines(keepends=True) if out.exists() else []
    return [json.loads(line) for line in lines if line.endswith(b"\n")]


async def until_heard(out: Path, count: int) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while len(heard(out)) < count:  # noqa: ASYNC110 - another process writes the file
            await asyncio.sleep(0.05)


async def stop(follower: Process, number: signal.Signals) -> None:
    follower.send_signal(number)
    await asyncio.wait_for(follower.wait(), TIMEOUT_S)


async def test_a_follower_and_its_node_are_killed_and_no_event_is_lost_or_comes_twice(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    out = tmp_path / "events.jsonl"
    hospital = network.folder / "organisations" / "hospital" / "admin.key"
    admin = PrivateKey(hospital.read_bytes())
    proposed: list[str] = []

    async with NetworkClient(network.genesis, first="node-4") as client:

        async def propose() -> None:
            receipt = await client.call(admin, "settings", "propose", ["heartbeat_ms", 20_000 + len(proposed)])
            proposed.append(receipt.txid.hex())
            await client.call(admin, "membership", "withdraw", [receipt.txid])

        follower = await start_follower(network, out)
        for _ in range(3):
            await propose()
        await until_heard(out, 3)

        await asyncio.to_thread(network.cluster.kill, "node-1")
        for _ in range(3):
            await propose()
        await until_heard(out, 6)

        network.cluster.start("node-1")
        await stop(follower, signal.SIGKILL)
        for _ in range(2):
            await propose()
        follower = await start_follower(network, out)
        await until_heard(out, 8)
        await asyncio.to_thread(network.cluster.stop, "node-2")
        await propose()
        await until_heard(out, 9)
        await stop(follower, signal.SIGTERM)
        assert follower.returncode == 0

    assert [event["txid"] for event in heard(out)] == proposed
    places = [tuple(map(int, event["place"].split(":"))) for event in heard(out)]
    assert places == sorted(set(places))


async def test_a_contract_is_asked_and_called_from_the_command_line(network: NetworkUnderTest) -> None:
    called = await must(network, "contract", "call", "settings", "propose", "heartbeat_ms", "21000", "--as", "hospital")
    assert [event["name"] for event in called["events"]] == ["proposed"]
    asked = await must(network, "contract", "query", "settings", "in_force", "--as", "university")
    assert asked["result"]["heartbeat_ms"] > 0
    code, refused = await blockrobot(
        network, "contract", "call", "settings", "propose", "colour", "1", "--as", "hospital"
    )
    assert (code, refused["code"]) == (4, "SETTING_UNKNOWN")
    traced = await must(network, "contract", "trace", refused["txid"], "--as", "hospital")
    assert (traced["code"], traced["gas_used"]) == (refused["code"], refused["gas_used"])
    assert traced["steps"][-1]["line"] == refused["line"]
