"""Addresses that a user gives are hints: certificates and the genesis file decide, and the known nodes stay."""

from __future__ import annotations

import json
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from click.testing import CliRunner

from clients.sdk.connections import NodeAddress
from clients.sdk.given_nodes import (
    NODES_FILE_MAX_BYTES,
    GivenNode,
    check_given,
    read_given,
    read_nodes_file,
    use_given_nodes,
)
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.node_option import NODE_VARIABLE
from clients.sdk.terminal.terminal import load_genesis
from clients.sdk.terminal.told_nodes import NODES_FILE
from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from consensus.state.membership import NODE, NODES, ORGANISATION, NodeRow, OrganisationRow
from network.cli.main import main
from network.provisioning.certificate_authority import Authority, create_authority, issue_node_certificate
from node.api import create_api
from tests.unit.clients.sdk import certified_nodes
from tests.unit.clients.sdk.certified_nodes import ELSEWHERE, WARD, CertifiedNodes
from tests.unit.clients.sdk.conftest import DEAD_URL
from tests.unit.node.api.small_network import SUBJECT, SmallNode

OTHER = create_authority("ward")


@pytest.fixture
async def stack() -> AsyncIterator[AsyncExitStack]:
    async with AsyncExitStack() as stack:
        yield stack


@pytest.fixture
async def town(tmp_path: Path, stack: AsyncExitStack) -> CertifiedNodes:
    town = CertifiedNodes(tmp_path, stack, "test")
    await town.ledger.start()
    return town


async def refused(client: NetworkClient, url: str, name: str = "") -> BlockRobotError:
    before = client.nodes
    (refusal,) = await client.use_given([GivenNode(url, name)])
    assert client.nodes == before
    return refusal


@pytest.mark.parametrize("name", ["", "n0"])
async def test_a_node_is_asked_where_the_user_says_by_a_certificate_that_names_another_address(
    town: CertifiedNodes, name: str
) -> None:
    client = await town.client()
    assert await client.use_given([GivenNode(await town.serve("n0"), name)]) == []
    await town.ledger.extend()
    assert (await client.newest_header(SUBJECT)).height == 1
    assert client.troubles == {}, "it was the first to be asked"


async def test_another_nodes_certificate_is_refused(town: CertifiedNodes) -> None:
    refusal = await refused(await town.client(), await town.serve("n0", shows="n1"), "n0")
    assert (refusal.code, "'n0'" in refusal.detail) == ("NODE_ADDRESS_WRONG", True)


async def test_a_certificate_of_somebody_elses_authority_is_refused(town: CertifiedNodes) -> None:
    client, url = await town.client(), await town.serve("n0", authority=OTHER)
    for name in ("", "n0"):
        assert (await refused(client, url, name)).code == "NODE_ADDRESS_WRONG"


async def test_a_certificate_of_no_version_that_there_is_is_refused(
    town: CertifiedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenSSL serves it, and who reads it gets no further than its version."""
    issued = issue_node_certificate(WARD, "n0", ELSEWHERE)
    written = bytearray(ssl.PEM_cert_to_DER_cert(issued.certificate_pem.decode()))
    written[written.index(b"\xa0\x03\x02\x01\x02") + 4] = 1
    broken = replace(issued, certificate_pem=ssl.DER_cert_to_PEM_cert(bytes(written)).encode())
    monkeypatch.setattr(certified_nodes, "issue_node_certificate", lambda *_: broken)
    assert (await refused(await town.client(), await town.serve("n0"))).code == "NODE_ADDRESS_WRONG"


async def test_a_node_of_another_chain_is_refused_though_its_certificate_is_right(
    town: CertifiedNodes, tmp_path: Path, stack: AsyncExitStack
) -> None:
    other = CertifiedNodes(tmp_path, stack, "another")
    await other.ledger.start()
    refusal = await refused(await town.client(), await other.serve("n0"))
    assert (refusal.code, "no node of this chain" in refusal.detail) == ("NODE_ADDRESS_WRONG", True)


async def test_another_server_is_refused(town: CertifiedNodes) -> None:
    client = await town.client()
    assert (await refused(client, await town.serve("n0", of=web.Application()))).code == "NODE_ADDRESS_WRONG"
    plain = TestServer(web.Application())
    await plain.start_server()
    town.stack.push_async_callback(plain.close)
    url = str(plain.make_url("")).rstrip("/")
    assert (await refused(client, url, "n0")).code == "NODE_ADDRESS_WRONG"
    for name in ("", "n0"):
        assert (await refused(client, url.replace("http:", "https:"), name)).code == "NODE_ADDRESS_WRONG"


@pytest.mark.parametrize(
    ("host", "shows", "authority"),
    [("n1.example", "n1", WARD), ("n0.example", "n0", OTHER), ("n0.example", "n0", WARD)],
    ids=["another node of the organisation", "somebody else under its name", "the node itself"],
)
async def test_a_name_that_dns_leads_elsewhere_is_believed_only_with_the_certificate_that_the_chain_names(
    town: CertifiedNodes, monkeypatch: pytest.MonkeyPatch, host: str, shows: str, authority: Authority
) -> None:
    url = await town.serve("n0", shows=shows, host=host, authority=authority)
    look_up = socket.getaddrinfo

    def mislead(name: str, *arguments: Any, **options: Any) -> Any:
        assert name == "n0.example"
        return look_up("127.0.0.1", *arguments, **options)

    monkeypatch.setattr(socket, "getaddrinfo", mislead)
    listed = NodeAddress("n0", url.replace("127.0.0.1", "n0.example"), WARD.certificate_pem)
    client = await town.client()
    if (shows, authority) == ("n0", WARD):
        assert b"state_root" in await client.ask_node(listed, "GET", "/v1/genesis")
        return
    with pytest.raises(BlockRobotError, match=r"^NODE_UNREACHABLE.*Certificate"):
        await client.ask_node(listed, "GET", "/v1/genesis")


async def test_where_nobody_answers_that_is_said(town: CertifiedNodes) -> None:
    client = await town.client()
    for name in ("", "n0"):
        assert (await refused(client, DEAD_URL.replace("http:", "https:"), name)).code == "NODE_UNREACHABLE"


@pytest.mark.parametrize("host", ["a..b", "a" * 64 + ".example"])
@pytest.mark.parametrize("name", ["", "n0"])
async def test_a_host_name_that_cannot_be_looked_up_is_nobodys(town: CertifiedNodes, host: str, name: str) -> None:
    assert (await refused(await town.client(), f"https://{host}:1", name)).code == "NODE_UNREACHABLE"


async def test_plain_http_on_this_machine_needs_a_name(town: CertifiedNodes) -> None:
    server = TestServer(create_api(SmallNode.around(town.ledger, "n0").services))
    await server.start_server()
    town.stack.push_async_callback(server.close)
    url = str(server.make_url("")).rstrip("/")
    client = await town.client()
    assert (await refused(client, url)).code == "NODE_ADDRESS_UNUSABLE"
    assert await client.use_given([GivenNode(url, "n0")]) == []
    assert await client.query("echo", "back", [1], SUBJECT) == [1]


async def test_an_organisation_that_nobody_knows_is_refused(town: CertifiedNodes) -> None:
    url = await town.serve("n0", shows="n9", authority=create_authority("strangers"))
    assert "unknown in this network" in (await refused(await town.client(), url)).detail


async def test_a_node_that_joined_later_leads_to_those_of_today(town: CertifiedNodes) -> None:
    """The addresses of the genesis are all dead; the client is told of a node that the genesis does not name."""
    later = await town.serve("n9")
    row = NodeRow("n9", "ward", "203.0.113.9", 1, "https://203.0.113.9:1", b"", b"", b"", "active", 1)
    organisation = OrganisationRow("ward", WARD.certificate_pem, "active", 0)
    state = {NODES.flat: NODES.encode(["n9"]), NODE.key("n9"): NODE.encode(row)}
    await town.ledger.extend(writes=state | {ORGANISATION.key("ward"): ORGANISATION.encode(organisation)})
    client = await town.client()
    assert await client.use_given([GivenNode(later)]) == []
    assert "n9" not in [node.name for node in client.nodes], "what is on no list does not count among the nodes"
    assert (await client.newest_header(SUBJECT)).height == 1
    assert [(node.name, node.url) for node in client.nodes] == [("n9", later)]


async def test_the_refusal_of_a_node_that_no_list_names_counts_for_nothing(town: CertifiedNodes) -> None:
    client = await town.client()
    assert await client.use_given([GivenNode(await town.serve("n9"))]) == []
    assert await client.use_given([GivenNode(await town.serve("n0"))]) == []
    said: list[str] = []

    async def work(node: object) -> str:
        name = str(getattr(node, "name", ""))
        said.append(name)
        if name == "n9":
            raise BlockRobotError("CALL_REFUSED")
        return name

    assert await client.with_any_node(work) == "n0"
    assert said == ["n9", "n0"]


@pytest.mark.parametrize(
    ("url", "because"),
    [
        ("https://user:hunter2@node.example:7273", "a password"),
        (
            "http://192.0.2.1:7273",
            "^NODE_ADDRESS_UNUSABLE: The address of the node is not on loopback, so it needs HTTPS",
        ),
        ("https://node.example:7273/v1", "more than a host and a port"),
        ("https://node.example:7273?token=hunter2", "more than a host and a port"),
        ("ftp://node.example", "no HTTP address"),
        ("https://node.example:99999", "no URL"),
        ("https://node.example\\@evil.example", "no URL"),
        ("https://node .example", "no URL"),
        ("https://" + "n" * 600, "no URL"),
        ("node.example:7273", "no HTTP address"),
    ],
)
def test_an_address_that_no_client_may_use_is_refused_without_quoting_it(url: str, because: str) -> None:
    with pytest.raises(BlockRobotError, match=because) as refusal:
        check_given(url)
    assert refusal.value.code == "NODE_ADDRESS_UNUSABLE"
    assert "hunter2" not in refusal.value.detail


def test_a_name_may_stand_before_the_address() -> None:
    assert read_given("n0=https://a.example:1/") == GivenNode("https://a.example:1", "n0")
    assert read_given("https://a.example:1") == GivenNode("https://a.example:1")


def written(folder: Path, *nodes: tuple[str, str]) -> Path:
    path = folder / NODES_FILE
    path.write_text(json.dumps({"nodes": [{"name": name, "url": url} for name, url in nodes]}))
    return path


@pytest.mark.parametrize(
    "text", ["", "[]", '{"nodes": [{"name": "n0"}]}', '{"nodes": [], "more": 1}', "[" * 5000, "\ud800", "{" * 70_000]
)
def test_a_file_of_another_form_or_size_lists_nobody(tmp_path: Path, text: str) -> None:
    path = tmp_path / NODES_FILE
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    given, (refusal,) = read_nodes_file(path)
    assert (given, refusal.code) == ([], "FILE_UNUSABLE")
    assert ("larger" in refusal.detail) == (len(text) > NODES_FILE_MAX_BYTES)


def test_a_file_may_not_list_any_number_of_nodes(tmp_path: Path) -> None:
    given, refusals = read_nodes_file(written(tmp_path, *[(f"n{n}", "https://a.example") for n in range(65)]))
    assert (given, [refusal.code for refusal in refusals]) == ([], ["FILE_UNUSABLE"])


async def test_a_command_whose_file_lists_liars_alone_goes_on_with_the_nodes_it_knows(
    town: CertifiedNodes, capsys: pytest.CaptureFixture[str]
) -> None:
    true, liar = await town.serve("n0"), await town.serve("n0", authority=OTHER)
    (town.folder / "genesis.json").write_text(genesis_to_json(town.ledger.genesis))
    written(town.folder, ("n0", liar), ("n1", "http://192.0.2.1:1"), ("n2", "https://u:hunter2@a.example"))
    with click.Context(main):
        genesis = load_genesis(town.folder / "genesis.json")
        async with NetworkClient(genesis, {"n0": true.replace("127.0.0.1", "localhost")}) as client:
            before = client.nodes
            await use_given_nodes(client, genesis.chain_id)
            await use_given_nodes(client, genesis.chain_id)
            assert client.nodes == before
    said = capsys.readouterr().err
    assert said.count("NODE_ADDRESS_WRONG. Next step:") == 1, "once for each command"
    assert said.count("NODE_ADDRESS_UNUSABLE. Next step:") == 2
    assert "hunter2" not in said


async def test_what_is_typed_goes_before_the_file(town: CertifiedNodes) -> None:
    typed, listed = await town.serve("n0"), await town.serve("n0")
    (town.folder / "genesis.json").write_text(genesis_to_json(town.ledger.genesis))
    written(town.folder, ("n0", listed))
    with main.make_context("blockrobot", ["--node", typed, "status"]):
        genesis = load_genesis(town.folder / "genesis.json")
        async with NetworkClient(genesis) as client:
            await use_given_nodes(client, genesis.chain_id)
            assert next(node.url for node in client.nodes if node.name == "n0") == typed


@pytest.mark.parametrize("by_variable", [False, True])
def test_a_typed_address_that_cannot_be_used_is_wrong_usage(by_variable: bool) -> None:
    url = "https://u:hunter2@a.example"
    typed = [] if by_variable else ["--node", url]
    told = CliRunner().invoke(main, [*typed, "org", "list"], env={NODE_VARIABLE: url} if by_variable else {})
    assert told.exit_code == 2
    assert "holds a user name or a password" in told.output
    assert "hunter2" not in told.output
