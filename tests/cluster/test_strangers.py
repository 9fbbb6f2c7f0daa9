"""Whoever is not a node of the network gets nothing from a node's peer port, and does not disturb it."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

import pytest
import pytest_asyncio

from consensus.primitives.encoding import encode
from network.provisioning.certificate_authority import (
    Authority,
    create_authority,
    issue_node_certificate,
    load_authority,
    write_secret,
)
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello, encode_frame
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest

pytestmark = [pytest.mark.smoke, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def network(shared_network: NetworkUnderTest) -> NetworkUnderTest:
    """One network for all tests here: none of them breaks it."""
    return shared_network


TARGET = "node-2"


def _client_context(folder: Path, authority: Authority | None, name: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    if authority is not None:
        certificate = issue_node_certificate(authority, name)
        write_secret(folder / f"{name}.key", certificate.key_pem)
        (folder / f"{name}.crt").write_bytes(certificate.certificate_pem)
        context.load_cert_chain(folder / f"{name}.crt", folder / f"{name}.key")
    return context


async def _knock(network: NetworkUnderTest, context: ssl.SSLContext | None, payload: bytes) -> bytes:
    """Connect to the peer port of TARGET, say something, and return all that comes back."""
    port = network.cluster.config(TARGET).p2p_port
    try:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
        writer.write(payload)
        answer = await asyncio.wait_for(reader.read(), FINAL_TIMEOUT_S)
        writer.close()
    except TimeoutError:
        raise AssertionError("the node leaves a stranger's connection open") from None
    except OSError:
        return b""
    return answer


async def _logged(network: NetworkUnderTest, code: str) -> None:
    """Wait until the node's log has this code: the stranger may be cut off before it is written."""
    path = network.cluster.config(TARGET).log_path
    async with asyncio.timeout(FINAL_TIMEOUT_S):
        while f'"{code}"' not in path.read_text(encoding="utf-8"):  # noqa: ASYNC110 - another process writes it
            await asyncio.sleep(0.05)


async def test_plain_tcp_is_cut_off(network: NetworkUnderTest) -> None:
    hello = Hello(version=PROTOCOL_VERSION, chain_id=network.genesis.chain_id, name="node-1", finalized_height=0)
    answer = await _knock(network, None, encode_frame(FrameKind.HELLO, encode(hello)) * 3)
    assert FrameKind.HELLO not in answer[4:5]
    await network.finalize(TARGET, network.transaction())


async def test_a_client_without_a_certificate_is_refused(network: NetworkUnderTest, tmp_path: Path) -> None:
    assert await _knock(network, _client_context(tmp_path, None, "node-1"), b"") == b""
    await network.finalize(TARGET, network.transaction())


async def test_a_server_name_that_cannot_be_read_is_told_to_nobody(network: NetworkUnderTest, tmp_path: Path) -> None:
    """What a node's process writes besides its log has no limit."""
    sent = ssl.MemoryBIO()
    handshake = _client_context(tmp_path, None, "node-1").wrap_bio(ssl.MemoryBIO(), sent, server_hostname="hospital")
    with pytest.raises(ssl.SSLWantReadError):
        handshake.do_handshake()
    hello = sent.read()
    assert hello.count(b"hospital") == 1
    await _knock(network, None, hello.replace(b"hospital", b"\xff" * 8))
    await network.finalize(TARGET, network.transaction())
    assert b"UnicodeDecodeError" not in (network.cluster.config(TARGET).data_dir / "output.log").read_bytes()


async def test_a_certificate_of_a_foreign_authority_is_refused(network: NetworkUnderTest, tmp_path: Path) -> None:
    foreign = create_authority("hospital")
    assert await _knock(network, _client_context(tmp_path, foreign, "node-1"), b"") == b""
    await network.finalize(TARGET, network.transaction())


async def test_an_organisation_cannot_pass_for_a_node_of_another(network: NetworkUnderTest, tmp_path: Path) -> None:
    """The university's authority issues a certificate in the name of the hospital's node."""
    assert network.genesis.node("node-1").organisation == "hospital"
    university = load_authority(network.folder / "organisations" / "university")
    assert await _knock(network, _client_context(tmp_path, university, "node-1"), b"") == b""
    await _logged(network, "PEER_CERTIFICATE_FOREIGN")


async def test_a_name_that_is_no_node_is_refused(network: NetworkUnderTest, tmp_path: Path) -> None:
    hospital = load_authority(network.folder / "organisations" / "hospital")
    assert await _knock(network, _client_context(tmp_path, hospital, "node-9"), b"") == b""
    await _logged(network, "PEER_REFUSED")
