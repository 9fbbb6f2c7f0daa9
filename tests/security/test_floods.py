"""Floods against real nodes: what nobody signed costs its sender, not the network, and the sender is named."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path
from typing import Any

import aiohttp
import msgspec
import pytest

from consensus.chain.transaction import TransactionWire
from consensus.primitives.encoding import encode
from network.cluster import read_metric
from network.doctor.examination import examine_network
from network.provisioning.certificate_authority import issue_node_certificate, load_authority
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello, TransactionBatch, encode_frame
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import MSGPACK, new_key

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

STRANGER_ADDRESS = "127.0.0.66"
TARGET, IMPOSTOR = "node-2", "node-1"
CHECKED = "blockrobot_signatures_checked_total"


def _false(network: NetworkUnderTest) -> bytes:
    """A transaction in a member's name, with a signature over another one."""
    mine, other = network.transaction(), network.transaction()
    return encode(TransactionWire(body=mine.body_bytes, signature=other.signature))


async def _flood(network: NetworkUnderTest, wires: list[bytes], times: int) -> list[str]:
    """Submit a batch again and again from an address that nobody else has; return the codes of what came back."""
    codes: list[str] = []
    connector = aiohttp.TCPConnector(local_addr=(STRANGER_ADDRESS, 0))
    async with aiohttp.ClientSession(connector=connector) as http:
        for _ in range(times):
            body, url = msgspec.msgpack.encode(wires), network.url("node-1") + "/v1/transactions"
            async with http.post(url, data=body, headers={"Content-Type": MSGPACK}) as response:
                answer: dict[str, Any] = await response.json(content_type=None)
            codes += [row["error"]["code"] for row in answer.get("results", [])] or [answer["code"]]
    return codes


async def _checked(network: NetworkUnderTest) -> float:
    return await read_metric(network.cluster.config("node-1"), CHECKED) or 0.0


async def test_no_signature_of_a_stranger_is_checked_at_all(network: NetworkUnderTest) -> None:
    strangers = [network.sign(new_key(), "records", "record", [bytes(32)]).wire for _ in range(256)]
    before = await _checked(network)
    codes = await _flood(network, strangers, 4)
    assert set(codes) <= {"SENDER_NOT_ADMITTED", "RATE_LIMITED"}
    assert await _checked(network) - before < 256, "only what others do meanwhile"
    await network.finalize("node-1", network.transaction())


async def test_false_signatures_in_a_members_name_end_with_their_addresss_budget_and_the_member_goes_on(
    network: NetworkUnderTest,
) -> None:
    wires = [_false(network) for _ in range(256)]
    floods = await asyncio.gather(*(_flood(network, wires, 8) for _ in range(8)))
    assert {code for codes in floods for code in codes} == {"SENDER_NOT_ADMITTED", "RATE_LIMITED"}
    await network.finalize("node-1", network.transaction())
    status = await network.status("node-1")
    assert f"loopback {STRANGER_ADDRESS}" in {row["peer"] for row in status["over_budget"]}
    found = await asyncio.to_thread(examine_network, network.folder)
    assert any(item.code == "OVER_BUDGET" and STRANGER_ADDRESS in item.detail for item in found.findings)
    log = network.cluster.config("node-1").log_path.read_text()
    assert "over_budget" in log
    assert STRANGER_ADDRESS in log


async def test_a_thief_of_a_certificate_is_cut_off_at_the_first_false_signature_and_named(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    stolen = issue_node_certificate(load_authority(network.folder / "organisations" / "hospital"), IMPOSTOR)
    (tmp_path / "peer.key").write_bytes(stolen.key_pem)
    (tmp_path / "peer.crt").write_bytes(stolen.certificate_pem)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(tmp_path / "peer.crt", tmp_path / "peer.key")
    port = network.cluster.config(TARGET).p2p_port
    batch = TransactionBatch(transactions=tuple(_false(network) for _ in range(3)))
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    hello = Hello(version=PROTOCOL_VERSION, chain_id=network.genesis.chain_id, name=IMPOSTOR, finalized_height=0)
    frames = encode_frame(FrameKind.HELLO, encode(hello)), encode_frame(FrameKind.TRANSACTIONS, encode(batch))
    writer.write(b"".join(frames))  # at once: the genuine node comes back at once too, and takes its link back
    await asyncio.wait_for(_read_to_end(reader), 20)
    writer.close()
    (row,) = (await network.status(TARGET))["cut_off_peers"]
    assert (row["peer"], row["code"]) == (IMPOSTOR, "SIGNATURE_INVALID")
    found = await asyncio.to_thread(examine_network, network.folder)
    assert any(item.code == "PEER_CUT_OFF" and item.node == IMPOSTOR for item in found.findings)
    await network.finalize("node-3", network.transaction())
    async with asyncio.timeout(30):
        while IMPOSTOR not in (await network.status(TARGET))["peers"]:  # noqa: ASYNC110 - the genuine one comes back
            await asyncio.sleep(0.2)


async def _read_to_end(reader: asyncio.StreamReader) -> None:
    try:
        while await reader.read(65_536):
            pass
    except OSError:
        pass
