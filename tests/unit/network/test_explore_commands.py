"""What `blockrobot explore` hands to a browser, and what it says when it cannot."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer
from click.testing import CliRunner

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from clients.sdk.sessions import Sessions
from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from network.cli.cluster import explore_commands
from network.cli.cluster.explore_commands import ExplorerAccess, explore, explorer_page
from network.cli.governance.governance_signer import Signer
from node.api import create_api
from tests.unit.node.api.small_network import ADMIN, OWNER, STRANGER, SUBJECT, SmallLedger, SmallNode, make_genesis
from tests.wallet_page_client import SESSION_HEADER, WalletPage


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


async def test_the_page_asks_the_node_in_the_members_name_and_no_token_leaves_the_command(
    served: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, _ = served
    tokens: set[str] = set()
    open_session = Sessions.token

    async def note(*args: Any, **options: Any) -> str:
        token = await open_session(*args, **options)
        tokens.add(token)
        return token

    monkeypatch.setattr(Sessions, "token", note)
    answers = ""
    for key in (ADMIN, SUBJECT):
        access = await explore_commands._enter_any(client, signer(key, client), None)
        async with explorer_page(access, tmp_path) as page:
            file = (await page.start()).redirect_file
            assert file.stat().st_mode & 0o777 == 0o600
            assert client.nodes[0].url not in file.read_text()
            async with WalletPage(file) as browser:
                status, found = await browser.ask("GET", "/api/v1/explorer/status?after_height=0&wait_ms=0")
                assert (status, found["node"]) == (200, "n0")
                status, found = await browser.ask("GET", "/api/v1/contracts")
                assert status == 200
                status, found = await browser.ask("GET", "/api/v1/explorer/headers/" + "00" * 32)
                assert (status, found["code"]) == (404, "NOT_FOUND")
                query = {"contract": "nobody", "view": "x", "args": "90"}
                status, found = await browser.ask("POST", "/api/v1/queries", query)
                assert (status, found["code"]) == (404, "TRANSACTION_CONTRACT_UNKNOWN")
                for method, path in (
                    ("GET", "contracts"),
                    ("GET", "nothing"),
                    ("POST", "queries"),
                    ("POST", "sessions"),
                ):
                    place = f"{browser.origin}/api/v1/{path}"
                    async with browser.http.request(method, place, json=query, headers=browser.headers) as answer:
                        answers += f"{answer.headers} {await answer.text()}"
                for path in ("sessions", "transactions", "session-challenges"):
                    assert (await browser.ask("POST", f"/api/v1/{path}", {}))[1]["code"] == "METHOD_NOT_ALLOWED"
                del browser.headers[SESSION_HEADER]
                status, found = await browser.ask("GET", "/api/v1/contracts")
                assert (status, found["code"]) == (401, "PAGE_SESSION_REQUIRED")
            answers += file.read_text() if file.exists() else ""
    assert len(tokens) >= 2
    assert not [token for token in tokens if token in answers]


async def test_a_node_that_is_away_is_said_to_be_so(served: Any, tmp_path: Path) -> None:
    client, _ = served
    away = ExplorerAccess(NodeAddress("n0", "http://127.0.0.1:9"), signer(ADMIN, client))
    async with explorer_page(away, tmp_path) as page, WalletPage((await page.start()).redirect_file) as browser:
        status, found = await browser.ask("GET", "/api/v1/explorer/status")
    assert (status, found["code"]) == (503, "NODE_UNREACHABLE")


async def test_who_is_no_member_gets_no_link_and_an_unknown_node_is_said_to_be_so(served: Any) -> None:
    client, _ = served
    for key, code in ((STRANGER, "SESSION_REFUSED"), (OWNER, "NOT_PERMITTED")):
        with pytest.raises(BlockRobotError, match=f"^{code}:"):
            await explore_commands._enter_any(client, signer(key, client), None)
    with pytest.raises(BlockRobotError) as refused:
        await explore_commands._enter_any(client, signer(ADMIN, client), "n9")
    assert refused.value.code == "NOT_FOUND"
    assert "it has n0" in refused.value.detail


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
