"""Nodes behind HTTPS, by certificates of their organisation."""

from __future__ import annotations

import ssl
from contextlib import AsyncExitStack
from pathlib import Path

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from msgspec.structs import replace

from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import Genesis
from network.provisioning.certificate_authority import Authority, create_authority, issue_node_certificate
from node.api import create_api
from tests.unit.node.api import small_network
from tests.unit.node.api.small_network import ManualClock, SmallLedger, SmallNode

WARD = create_authority("ward")
ELSEWHERE = "203.0.113.7"
"""What certificates name here: not the address at which their nodes are asked."""


def with_certificate(genesis: Genesis, network: str = "test") -> Genesis:
    (ward,) = genesis.organisations
    nodes = tuple(replace(node, api_url="https://127.0.0.1:9") for node in genesis.nodes)
    ward = replace(ward, ca_certificate=WARD.certificate_pem)
    return replace(genesis, network=network, organisations=(ward,), nodes=nodes)


class CertifiedNodes:
    """Nodes of one network behind certificates, at addresses that its genesis file does not name."""

    def __init__(self, folder: Path, stack: AsyncExitStack, network: str) -> None:
        self.folder = folder
        self.stack = stack
        made = small_network.make_genesis
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(small_network, "make_genesis", lambda root: with_certificate(made(root), network))
            self.ledger = SmallLedger()

    async def serve(
        self,
        name: str,
        *,
        shows: str = "",
        authority: Authority = WARD,
        host: str = ELSEWHERE,
        of: web.Application | None = None,
    ) -> str:
        issued = issue_node_certificate(authority, shows or name, host)
        (self.folder / "crt.pem").write_bytes(issued.certificate_pem)
        (self.folder / "key.pem").write_bytes(issued.key_pem)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.folder / "crt.pem", self.folder / "key.pem")
        server = TestServer(of or create_api(SmallNode.around(self.ledger, name).services), scheme="https")
        await server.start_server(ssl=context)
        self.stack.push_async_callback(server.close)
        return str(server.make_url("")).rstrip("/")

    async def client(self) -> NetworkClient:
        return await self.stack.enter_async_context(NetworkClient(self.ledger.genesis, clock=ManualClock()))
