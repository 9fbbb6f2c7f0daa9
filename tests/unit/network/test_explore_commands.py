"""What `blockrobot explore` hands to a browser, and what it says when it cannot."""

from __future__ import annotations

import json
import os
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer
from click.testing import CliRunner

from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from network.cli.cluster import explore_commands
from network.cli.cluster.explore_commands import LINK_LIFETIME_S, explore, keep_link
from network.cli.governance.governance_signer import Signer
from node.api import create_api
from tests.unit.node.api.small_network import ADMIN, OWNER, STRANGER, SUBJECT, SmallLedger, SmallNode, make_genesis

TARGET = "http://127.0.0.1:1/explorer/#in=answer"


@pytest.fixture
async def served() -> AsyncIterator[tuple[NetworkClient, TestClient[web.Request, web.Application]]]:
    """A node in this process, and a client that knows where it is."""
    node = SmallNode.around(await SmallLedger().start())
    async with TestClient(TestServer(create_api(node.services))) as http:
        url = str(http.make_url("")).rstrip("/")
        async with NetworkClient(node.ledger.genesis, {"n0": url}, clock=node.clock) as client:
            yield client, http


def signer(key: Any, client: NetworkClient) -> Signer:
    return Signer(Path(), client.genesis, "somebody", key)


async def test_the_link_opens_a_session_once_and_holds_no_token(served: Any) -> None:
    client, http = served
    for key in (ADMIN, SUBJECT):
        entrance = await explore_commands._enter_any(client, signer(key, client), None)
        address, _, answer = entrance.target.partition("#in=")
        assert address == f"{client.nodes[0].url}/explorer/"
        public_key, challenge, signature = answer.split(".")
        document = {"public_key": public_key, "challenge": challenge, "signature": signature}
        assert public_key == key.public_key.hex()
        codes = [(await http.post("/v1/sessions", json=document)).status for _ in range(2)]
        assert codes == [200, 401]


async def test_who_is_no_member_gets_no_link_and_an_unknown_node_is_said_to_be_so(served: Any) -> None:
    client, _ = served
    for key, code in ((STRANGER, "SESSION_REFUSED"), (OWNER, "NOT_PERMITTED")):
        with pytest.raises(BlockRobotError, match=f"^{code}:"):
            await explore_commands._enter_any(client, signer(key, client), None)
    with pytest.raises(BlockRobotError) as refused:
        await explore_commands._enter_any(client, signer(ADMIN, client), "n9")
    assert refused.value.code == "NOT_FOUND"
    assert "it has n0" in refused.value.detail


def test_a_link_is_for_its_owner_alone_and_old_ones_are_removed(tmp_path: Path) -> None:
    folder = tmp_path / "links"
    old = keep_link(folder, TARGET)
    long_ago = time.time() - LINK_LIFETIME_S - 1
    os.utime(old, (long_ago, long_ago))
    other = folder / "mine.html"
    other.write_text("mine")
    file = keep_link(folder, TARGET)
    assert (file.stat().st_mode & 0o777, folder.stat().st_mode & 0o777) == (0o600, 0o700)
    assert set(folder.iterdir()) == {file, other}
    assert TARGET in file.read_text()


def test_without_a_network_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    answer = CliRunner().invoke(explore, ["--json"])
    assert answer.exit_code != 0
    assert json.loads(answer.output)["error"]["code"] == "CLUSTER_NOT_RUNNING"


def test_two_ways_of_saying_who_looks_are_one_too_many(tmp_path: Path) -> None:
    (tmp_path / "genesis.json").write_text(genesis_to_json(make_genesis(bytes(32), 4)))
    answer = CliRunner().invoke(explore, ["--as", "hospital", "--profile", "anna", "--dir", str(tmp_path)])
    assert answer.exit_code == 2
    assert "Say once who signs" in answer.output
