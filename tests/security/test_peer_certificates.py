"""Whoever comes to a peer port with the wrong certificate learns nothing; a genuine one that counts no more, only why."""

from __future__ import annotations

import asyncio
import datetime as dt
import ssl
from pathlib import Path

import pytest

from clients.sdk.chain.governance import Governor, read_membership
from clients.sdk.network_client import NetworkClient
from consensus.primitives.encoding import decode, encode
from consensus.primitives.keys import PrivateKey
from network.provisioning.certificate_authority import (
    Authority,
    NodeCertificate,
    create_authority,
    issue_node_certificate,
    load_authority,
)
from network.provisioning.node_certificates import serial_bytes
from node.p2p.wire import PROTOCOL_VERSION, FrameDecoder, FrameKind, Hello, Refusal, encode_frame
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest
from tests.security.intruder import new_key
from tests.twin_authority import twin_of

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

TARGET, IMPOSTOR = "node-2", "node-1"


def _authority(network: NetworkUnderTest, name: str) -> Authority:
    return load_authority(network.folder / "organisations" / name)


async def _knock(network: NetworkUnderTest, folder: Path, certificate: NodeCertificate, name: str) -> bytes:
    """Come to the target's peer port with a certificate, say hello in its name, and return all that comes back."""
    (folder / "peer.key").write_bytes(certificate.key_pem)
    (folder / "peer.crt").write_bytes(certificate.certificate_pem)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(folder / "peer.crt", folder / "peer.key")
    hello = Hello(version=PROTOCOL_VERSION, chain_id=network.genesis.chain_id, name=name, finalized_height=0)
    try:
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", network.cluster.config(TARGET).p2p_port, ssl=context
        )
        writer.write(encode_frame(FrameKind.HELLO, encode(hello)))
        answer = await asyncio.wait_for(reader.read(), 10)
        writer.close()
    except OSError:
        return b""
    return answer


def _reason(answer: bytes) -> str:
    """The code of a refusal, which must be all that was said."""
    frames = list(FrameDecoder().feed(answer))
    assert [kind for kind, _ in frames] == [FrameKind.REFUSAL]
    return decode(frames[0][1], Refusal).code


async def _still_works(network: NetworkUnderTest) -> None:
    await network.finalize(TARGET, network.transaction())


async def test_a_strange_certificate_gets_no_byte_and_an_expired_one_is_told_so(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    stranger = issue_node_certificate(create_authority("hospital"), IMPOSTOR)
    assert await _knock(network, tmp_path, stranger, IMPOSTOR) == b""
    await _still_works(network)
    false = issue_node_certificate(_authority(network, "university"), IMPOSTOR)
    assert await _knock(network, tmp_path, false, IMPOSTOR) == b""
    await _still_works(network)
    unknown = issue_node_certificate(_authority(network, "hospital"), "node-0")
    assert await _knock(network, tmp_path, unknown, "node-0") == b""
    await _still_works(network)
    old = issue_node_certificate(_authority(network, "hospital"), IMPOSTOR, lifetime=dt.timedelta(hours=-1))
    assert _reason(await _knock(network, tmp_path, old, IMPOSTOR)) == "PEER_CERTIFICATE_EXPIRED"
    await _still_works(network)


async def test_a_stolen_certificate_counts_no_more_once_it_is_revoked(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    stolen = issue_node_certificate(_authority(network, "hospital"), IMPOSTOR)
    key = PrivateKey((network.folder / "organisations" / "hospital" / "admin.key").read_bytes())
    async with NetworkClient(network.genesis) as client:
        arguments = {"organisation": "hospital", "serial": serial_bytes(stolen.serial)}
        decision = await Governor(client, key).propose("membership", "revoke_certificate", arguments)
    await network.wait_height(TARGET, decision.height)
    assert _reason(await _knock(network, tmp_path, stolen, IMPOSTOR)) == "PEER_CERTIFICATE_REVOKED"
    assert IMPOSTOR in (await network.status(TARGET))["peers"], "the genuine node's own certificate counts"
    await _still_works(network)


async def test_nobody_else_revokes_an_organisations_certificate_alone(network: NetworkUnderTest) -> None:
    """The university asks for the hospital's certificate to be revoked; that waits for a majority."""
    key = PrivateKey((network.folder / "organisations" / "university" / "admin.key").read_bytes())
    async with NetworkClient(network.genesis) as client:
        arguments = {"organisation": "hospital", "serial": serial_bytes(4711)}
        decision = await Governor(client, key).propose("membership", "revoke_certificate", arguments)
    assert not decision.executed
    await _still_works(network)
    assert IMPOSTOR in (await network.status(TARGET))["peers"]


async def test_an_organisation_whose_authorities_look_like_others_keeps_no_nodes_apart(
    network: NetworkUnderTest,
) -> None:
    """A majority lets it in by hand: the commands would not, and the chain looks into no certificate."""
    owners = ("hospital", "university")
    admins = [PrivateKey((network.folder / "organisations" / name / "admin.key").read_bytes()) for name in owners]
    certificates = [create_authority("evil"), *(twin_of(_authority(network, name), "evil") for name in owners)]
    arguments = {
        "name": "evil",
        "ca_certificate": "".join(each.certificate_pem for each in certificates),
        "admins": [new_key().public_key],
        "registrars": [],
    }
    async with NetworkClient(network.genesis) as client:
        await Governor(client, admins[0]).propose("membership", "add_org", arguments)
        view = await read_membership(client, admins[1])
        (proposal,) = [each for each in view.proposals if each.kind == "add_org"]
        decision = await Governor(client, admins[1]).approve(proposal)
    for name in network.names:
        await network.wait_height(name, decision.height)
    network.cluster.stop(IMPOSTOR)
    network.cluster.start(IMPOSTOR)
    await network.cluster.wait_ready([IMPOSTOR])
    for name in network.names:
        async with asyncio.timeout(FINAL_TIMEOUT_S):
            while (await network.status(name))["peers"] != sorted({*network.names} - {name}):  # noqa: ASYNC110
                await asyncio.sleep(0.1)
    await _still_works(network)
