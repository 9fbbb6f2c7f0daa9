"""The demonstration while organisations change producers and settings: robot, wallets and custodians notice nothing."""

from __future__ import annotations

import asyncio
import subprocess
from pathlib import Path
from typing import Any

import pytest

from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import Genesis, genesis_from_json
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from tests.demo.test_demo import DEMO_TIMEOUT_S, ENDING_TIMEOUT_S, failed_checks, read_demo, start_demo

BETWEEN_CHANGES_S = 2.0


async def _read_genesis(network: Path, demo: subprocess.Popen[bytes]) -> Genesis:
    while demo.poll() is None:
        await asyncio.sleep(0.5)
        if (network / "genesis.json").exists():
            await asyncio.sleep(0.5)  # it is written last, but perhaps not to its end yet
            return genesis_from_json((network / "genesis.json").read_text(encoding="utf-8"))
    raise AssertionError("the demonstration ended before there was a network")


async def _decide(genesis: Genesis, admins: list[PrivateKey], contract: str, entry: str, arguments: list[Any]) -> None:
    """One organisation proposes and the other approves; an organisation removes its own producer alone."""
    async with NetworkClient(genesis) as client:
        receipt = await client.call(admins[0], contract, entry, arguments)
        if entry == "propose":
            subject = receipt.txid if contract == "settings" else arguments[0]
            await client.call(admins[1], contract, "approve", [subject])


async def _govern(network: Path, demo: subprocess.Popen[bytes]) -> int:
    """Change one thing after another while the demonstration runs; return how many changes were made."""
    genesis = await _read_genesis(network, demo)
    folders = [network / "organisations" / entry.name for entry in genesis.organisations]
    admins = [PrivateKey((folder / "admin.key").read_bytes()) for folder in folders]
    last = genesis.nodes[-1]
    owner = admins[[entry.name for entry in genesis.organisations].index(last.organisation)]
    changes = 0
    while demo.poll() is None:
        steps: list[tuple[list[PrivateKey], str, str, list[Any]]] = [
            (admins, "settings", "propose", ["base_timeout_ms", 400 + changes]),
            ([owner], "producers", "remove", [last.producer_key]),
            (admins, "producers", "propose", [last.producer_key]),
        ]
        for step in steps:
            try:
                await _decide(genesis, *step)
            except BlockRobotError as error:
                if demo.poll() is None and not error.entry.retryable:
                    raise
                break
            changes += 1
            await asyncio.sleep(BETWEEN_CHANGES_S)
        await asyncio.sleep(BETWEEN_CHANGES_S)
    return changes


@pytest.mark.long
@pytest.mark.timeout(DEMO_TIMEOUT_S + ENDING_TIMEOUT_S + 20)
async def test_the_story_holds_while_producers_and_settings_change(tmp_path: Path) -> None:
    demo = start_demo(tmp_path / "home", tmp_path / "demo")
    try:
        changes = await _govern(tmp_path / "demo" / "network", demo)
    finally:
        demo.terminate()
    code, answer = await asyncio.to_thread(read_demo, demo)
    assert failed_checks(answer) == []
    assert (code, answer["ok"], answer["frames"]["lost"]) == (0, True, 0)
    assert changes >= 3
