"""HTTPS is believed only by the CA that the genesis file names for the node's organisation; mute names hold up nobody."""

from __future__ import annotations

import asyncio
import datetime
import ipaddress
import socket
import ssl
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from msgspec.structs import replace

from clients.sdk.connections import Connections, NodeAddress
from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from node.api import create_api
from tests.unit.node.api.small_network import SUBJECT, SmallLedger, SmallNode


class Authority:
    """A CA that issues certificates for 127.0.0.1."""

    def __init__(self) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "ward")])
        self._certificate = self._build(self._name, self._key.public_key(), is_authority=True)
        self.pem = self._certificate.public_bytes(serialization.Encoding.PEM).decode()

    def _build(
        self, subject: x509.Name, public_key: ec.EllipticCurvePublicKey, *, is_authority: bool
    ) -> x509.Certificate:
        now = datetime.datetime.now(datetime.UTC)
        builder = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(self._name)
            .public_key(public_key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(hours=1))
            .not_valid_after(now + datetime.timedelta(hours=1))
            .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
            .add_extension(
                x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False
            )
        )
        return builder.sign(self._key, hashes.SHA256())

    def server_context(self, folder: Path) -> ssl.SSLContext:
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "n0")])
        certificate = self._build(subject, key.public_key(), is_authority=False)
        encoding = serialization.Encoding.PEM
        (folder / "crt.pem").write_bytes(certificate.public_bytes(encoding))
        (folder / "key.pem").write_bytes(
            key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        )
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "crt.pem", folder / "key.pem")
        return context


def with_authority(genesis: Genesis, authority: Authority) -> Genesis:
    organisation = replace(genesis.organisations[0], ca_certificate=authority.pem)
    return replace(genesis, organisations=(organisation,))


@asynccontextmanager
async def client_of(tmp_path: Path, issuer: Authority, trusted: Authority) -> AsyncIterator[NetworkClient]:
    """A client of one node behind HTTPS, whose genesis file names the `trusted` authority."""
    ledger = await SmallLedger().start()
    ledger.genesis = with_authority(ledger.genesis, trusted)
    server = TestServer(create_api(SmallNode.around(ledger).services), scheme="https")
    await server.start_server(ssl=issuer.server_context(tmp_path))
    try:
        async with NetworkClient(ledger.genesis, {"n0": str(server.make_url(""))}) as client:
            yield client
    finally:
        await server.close()


async def test_a_node_with_a_certificate_of_its_organisation_is_believed_to_be_it(tmp_path: Path) -> None:
    authority = Authority()
    async with client_of(tmp_path, authority, authority) as client:
        assert await client.query("echo", "back", [1], SUBJECT) == [1]


async def test_a_node_with_a_certificate_of_anyone_else_is_not_spoken_to(tmp_path: Path) -> None:
    async with client_of(tmp_path, Authority(), Authority()) as client:
        with pytest.raises(BlockRobotError) as refusal:
            await client.query("echo", "back", [1], SUBJECT)
    assert refusal.value.code == "NODE_UNREACHABLE"


async def test_names_that_nobody_answers_for_cut_no_client_off_from_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    given_up, look_up = threading.Event(), socket.getaddrinfo

    def look(host: str, *arguments: Any, **options: Any) -> Any:
        if host.startswith("mute"):
            given_up.wait(60)
            raise socket.gaierror(socket.EAI_AGAIN, "no server answered")
        return look_up("127.0.0.1" if host == "honest.example" else host, *arguments, **options)

    async def greet(_request: web.Request) -> web.Response:
        return web.Response(text="here")

    application = web.Application()
    application.router.add_get("/", greet)
    server, connections = TestServer(application), Connections()
    await server.start_server()
    monkeypatch.setattr(socket, "getaddrinfo", look)
    mute = [NodeAddress(f"a{count}", f"http://mute{count}.example:1") for count in range(24)]
    asking = [asyncio.create_task(connections.request(node, "GET", "/", lane=b"")) for node in mute]
    honest = NodeAddress("honest", f"http://honest.example:{server.port}")
    assert await connections.request(honest, "GET", "/", lane=b"") == b"here"
    assert not any(task.done() for task in asking)
    given_up.set()
    refusals = await asyncio.gather(*asking, return_exceptions=True)
    assert {each.code for each in refusals if isinstance(each, BlockRobotError)} == {"NODE_UNREACHABLE"}
    await connections.close()
    await server.close()
