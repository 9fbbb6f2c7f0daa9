"""`blockrobot` as a user runs it, on a network under test. For the tests of this folder."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

from tests.cluster.network_under_test import NetworkUnderTest

COMMAND_TIMEOUT_S = 60


async def blockrobot(network: NetworkUnderTest, *arguments: str) -> tuple[int, dict[str, Any]]:
    """Run a command with --json; return its exit code and its answer."""
    command = [sys.executable, "-m", "network.cli.main", *arguments, "--dir", str(network.folder), "--json"]
    process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
    output, _ = await asyncio.wait_for(process.communicate(), COMMAND_TIMEOUT_S)
    answer: dict[str, Any] = json.loads(output)
    return process.returncode or 0, answer


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
