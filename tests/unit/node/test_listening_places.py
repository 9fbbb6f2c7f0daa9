"""Where a node listens: for peers and for clients apart, over TLS wherever others reach it, and renewed while it runs."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest

from clients.sdk.connections import Connections, NodeAddress
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.provisioning.certificate_authority import create_authority
from network.provisioning.network_layout import create_network
from network.provisioning.node_certificates import get_authority, renew
from node import node_process
from node.api.access import request_rate_limiter
from node.config import NodeConfig, reading_headers
from node.limits.token_buckets import Allowance
from node.node_process import Node
from node.p2p import connection_acceptor
from node.p2p.connection_acceptor import OF_CLIENTS, bind_listener
from tests.cluster.network_under_test import find_base_port
from tests.unit.node.p2p.linked_nodes import eventually


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=find_base_port(1))
    return tmp_path / "network"


@pytest.fixture
async def node(folder: Path) -> AsyncIterator[Node]:
    """A node that serves its clients over TLS."""
    async with Node(replace(Cluster(folder).config("node-1"), api_tls=True)) as running:
        yield running


def address_of(node: Node, host: str = "127.0.0.1") -> NodeAddress:
    (owner,) = node.genesis.organisations
    return NodeAddress("node-1", f"https://{host}:{node.config.api_port}", owner.ca_certificate)


async def ask(address: NodeAddress) -> bytes:
    connections = Connections()
    try:
        return await connections.request(address, "GET", "/v1/genesis", lane=b"")
    finally:
        await connections.close()


async def test_clients_get_answers_over_tls_from_the_nodes_own_certificate_and_from_no_other(node: Node) -> None:
    assert b"organisations" in await ask(address_of(node))
    elsewhere = replace(address_of(node), url=f"https://127.0.0.2:{node.config.api_port}")
    impostor = replace(address_of(node), ca_certificate=create_authority("hospital").certificate_pem)
    for stranger in (impostor, elsewhere):
        with pytest.raises(BlockRobotError, match="NODE_UNREACHABLE"):
            await ask(stranger)


async def test_whoever_speaks_plain_text_or_an_old_tls_gets_nothing(node: Node) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", node.config.api_port)
    writer.write(b"GET /v1/genesis HTTP/1.1\r\nHost: x\r\n\r\n")
    heard = await asyncio.wait_for(reader.read(), 5)
    assert b"HTTP" not in heard
    writer.close()
    old = ssl.create_default_context()
    old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
    old.maximum_version = ssl.TLSVersion.TLSv1_2
    with pytest.raises((ssl.SSLError, ConnectionError)):
        await asyncio.open_connection("127.0.0.1", node.config.api_port, ssl=old)


async def test_a_renewed_certificate_is_shown_without_a_restart(node: Node, folder: Path) -> None:
    async def serial() -> int:
        context = ssl.create_default_context(cadata=node.genesis.organisations[0].ca_certificate)
        _, writer = await asyncio.open_connection("127.0.0.1", node.config.api_port, ssl=context)
        shown = writer.get_extra_info("peercert")["serialNumber"]
        writer.close()
        return int(shown, 16)

    before = await serial()
    renewed = renew(node.config, get_authority(folder, "hospital"))
    node.reload_certificate()
    assert await serial() == renewed != before


async def test_handshakes_that_nobody_ends_keep_other_addresses_in(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = replace(OF_CLIENTS, open_max_count=12, allowance=Allowance(us_per_s=1, burst_us=10**9))
    monkeypatch.setattr(node_process, "OF_CLIENTS", few)
    async with Node(replace(Cluster(folder).config("node-1"), api_tls=True)) as node:
        port = node.config.api_port
        silent = [await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0)) for _ in range(4)]
        with contextlib.suppress(ConnectionError):
            assert await silent[0][0].read() == b"", "the oldest of an address ends with its fourth"
        assert await ask(address_of(node))
        for _, writer in silent:
            writer.close()
        await eventually(lambda: all(reader.at_eof() for reader, _ in silent))


@pytest.mark.parametrize(("piece", "answered"), [(10_000, True), (1, False)])
async def test_records_of_tls_with_next_to_nothing_in_them_are_paid_by_their_address(
    node: Node, piece: int, answered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(us_per_s=1, burst_us=20_000))
    context = ssl.create_default_context(cadata=node.genesis.organisations[0].ca_certificate)
    reader, writer = await asyncio.open_connection("127.0.0.1", node.config.api_port, ssl=context)
    writer.write(b"POST /v1/transactions HTTP/1.1\r\nHost: node-1\r\nContent-Length: 60000\r\n\r\n")
    for _ in range(0, 60_000, piece):
        writer.write(b"x" * piece)
    try:
        heard = await asyncio.wait_for(reader.read(8), 10)
    except ConnectionError:
        heard = b""
    assert (heard == b"HTTP/1.1") == answered
    writer.close()


async def test_peers_and_clients_may_have_addresses_of_their_own(folder: Path) -> None:
    config = replace(Cluster(folder).config("node-1"), host="127.0.0.2", api_host="127.0.0.3")
    async with Node(config), aiohttp.ClientSession() as session:
        async with session.get(f"http://127.0.0.3:{config.api_port}/v1/genesis") as answer:
            assert answer.status == 200
        with socket.create_connection(("127.0.0.2", config.p2p_port), timeout=5):
            pass
        for host, port in (("127.0.0.2", config.api_port), ("127.0.0.3", config.p2p_port)):
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((host, port), timeout=5)


@pytest.mark.parametrize("host", ["::1", "::", "localhost"])
async def test_a_node_listens_at_ipv6_and_at_names_too(folder: Path, host: str) -> None:
    config: NodeConfig = replace(Cluster(folder).config("node-1"), api_host=host, api_tls=True)
    async with Node(config) as node:
        reached = ["[::1]"] if host == "::1" else ["127.0.0.1"] if host == "localhost" else ["[::1]", "127.0.0.1"]
        for each in reached:
            context = ssl.create_default_context(cadata=node.genesis.organisations[0].ca_certificate)
            _, writer = await asyncio.open_connection(
                each.strip("[]"), config.api_port, ssl=context, server_hostname="node-1"
            )
            writer.close()


@pytest.mark.parametrize(
    ("host", "number", "code"),
    [
        ("203.0.113.5", None, "ADDRESS_NOT_HERE"),
        ("2001:db8::5", None, "ADDRESS_NOT_HERE"),
        ("nobody.invalid", None, "ADDRESS_NOT_HERE"),
        ("127.0.0.1", errno.EADDRINUSE, "PORT_IN_USE"),
        ("127.0.0.1", errno.EACCES, "PORT_NOT_PERMITTED"),
    ],
)
def test_why_a_node_cannot_listen_is_told_apart(
    host: str, number: int | None, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_host: str, _port: int) -> socket.socket:
        raise OSError(number, "refused")

    if number is not None:
        monkeypatch.setattr(connection_acceptor, "open_listener", refuse)
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        bind_listener(host, find_base_port(1))


async def test_a_node_that_something_else_started_counts_as_running(node: Node, folder: Path) -> None:
    (row,) = await Cluster(folder).status()
    assert row.running
    assert row.status is not None
    assert row.status["name"] == node.config.name


async def test_figures_are_told_to_other_machines_at_a_port_of_their_own(folder: Path) -> None:
    port = find_base_port(1)
    config = replace(Cluster(folder).config("node-1"), metrics_host="127.0.0.2", metrics_port=port)
    async with Node(config), aiohttp.ClientSession() as session:
        token = reading_headers(config)
        for path, headers, status in (("/livez", {}, 200), ("/metrics", {}, 401), ("/metrics", token, 200)):
            async with session.get(f"http://127.0.0.2:{port}{path}", headers=headers) as answer:
                assert answer.status == status
