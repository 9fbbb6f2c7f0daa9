"""`blockrobot` as a user runs it, on a network under test. For the tests of this folder."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE
from pathlib import Path
from typing import Any

from tests.cluster.network_under_test import NetworkUnderTest

COMMAND_TIMEOUT_S = 120


async def run(*arguments: object, home: Path | None = None) -> tuple[int, dict[str, Any]]:
    """Run a command that prints JSON; return its exit code and its answer. In a home is a passphrase for its wallets."""
    own = {"BLOCKROBOT_HOME": str(home), "BLOCKROBOT_PASSPHRASE_FILE": str(home / "passphrase")} if home else {}
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "network.cli.main", *map(str, arguments)),
        env=os.environ | own,
        stdin=DEVNULL,
        stdout=PIPE,
        stderr=PIPE,
    )
    output, said = await asyncio.wait_for(process.communicate(), COMMAND_TIMEOUT_S)
    assert output, said.decode()
    return process.returncode or 0, json.loads(output)


async def blockrobot(network: NetworkUnderTest, *arguments: str) -> tuple[int, dict[str, Any]]:
    """Run a command on the network with --json; return its exit code and its answer."""
    return await run(*arguments, "--dir", network.folder, "--json")


async def must(network: NetworkUnderTest, *arguments: str) -> dict[str, Any]:
    """Run a command that has to succeed."""
    code, answer = await blockrobot(network, *arguments)
    assert (code, answer["ok"]) == (0, True), answer
    return answer


async def agree(network: NetworkUnderTest, *proposal: str) -> dict[str, Any]:
    """Let the hospital propose a change of membership and the university approve it."""
    proposed = await must(network, "org", "propose", *proposal, "--as", "hospital")
    if proposed["executed"]:
        return proposed
    approved = await must(network, "org", "approve", proposed["proposal"]["id"], "--as", "university")
    assert approved["executed"]
    return approved
