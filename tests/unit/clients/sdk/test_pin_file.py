"""What a client knows outlasts its process."""

from __future__ import annotations

import asyncio
import stat
from pathlib import Path
from typing import Any

import pytest

from clients.sdk.known_nodes import KnownCustodian, KnownNode, KnownNodes
from clients.sdk.network_client import open_pinned_client
from clients.sdk.new_files import replace_file
from clients.sdk.trust_pin import PIN_FILE, open_pin, read_pin, write_pin
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from tests.unit.node.api.small_network import SUBJECT


async def test_the_next_run_begins_where_the_last_one_was(nodes: Any, tmp_path: Path) -> None:
    genesis, path = nodes["n0"].node.ledger.genesis, tmp_path / PIN_FILE
    known = KnownNodes(0, (KnownNode("n1", nodes["n1"].url, ""),), (KnownCustodian("n1", "ward", bytes(33), 40),), 2)
    replace_file(path, write_pin(LightClient(genesis), known))
    await nodes["n0"].node.ledger.extend()
    async with open_pinned_client(genesis, path) as client:
        assert (await client.newest_header(SUBJECT)).height == 1
    light_client, kept = open_pin(genesis, read_pin(path))
    assert (light_client.header.height, kept) == (1, known)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert await asyncio.to_thread(lambda: [entry.name for entry in tmp_path.iterdir()]) == [PIN_FILE]


async def test_what_was_verified_is_kept_though_the_work_failed(nodes: Any, tmp_path: Path) -> None:
    genesis, path = nodes["n0"].node.ledger.genesis, tmp_path / PIN_FILE
    with pytest.raises(BlockRobotError):
        async with open_pinned_client(genesis, path):
            raise BlockRobotError("CALL_REFUSED")
    assert read_pin(path) is not None


async def test_a_damaged_pin_is_named_and_nothing_is_written_over_it(nodes: Any, tmp_path: Path) -> None:
    path = tmp_path / PIN_FILE
    path.write_bytes(b"no pin")
    with pytest.raises(BlockRobotError) as refusal:
        async with open_pinned_client(nodes["n0"].node.ledger.genesis, path):
            raise AssertionError("it was opened")
    assert refusal.value.code == "FILE_UNUSABLE"
    assert str(path) in refusal.value.detail
    assert read_pin(path) == b"no pin"
