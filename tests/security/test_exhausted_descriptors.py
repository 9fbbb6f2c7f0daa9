"""Whoever takes a node's connections takes none of the descriptors that its own work needs, at any of its ports."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import signal
import ssl
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import pytest_asyncio

from network.custody.custody_requests import ask_status
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import Intruder
from tests.security.test_exhaustion import ANSWER_MAX_S, Crowd
from tests.security.ward import Ward

pytestmark = pytest.mark.asyncio(loop_scope="module")

DESCRIPTORS_COUNT = 256
"""What some systems give a process that asks for nothing."""
THIEF, TARGET = "node-1", "node-2"
HALF_A_HEAD = b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "


@contextlib.contextmanager
def _few_descriptors() -> Iterator[None]:
    """What is started meanwhile has no more."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS_COUNT, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NetworkUnderTest]:
    network = NetworkUnderTest(tmp_path_factory.mktemp("descriptors") / "network", nodes=4)
    try:
        with _few_descriptors():
            await network.start()
        yield network
    finally:
        await network.close()


@contextlib.asynccontextmanager
async def _silent_thief(network: NetworkUnderTest) -> AsyncIterator[None]:
    """Hold connections with a stolen certificate that shake hands and say no hello, from many addresses."""
    config = network.cluster.config(THIEF)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(config.tls_certificate_path, config.tls_key_path)
    port, held = network.cluster.config(TARGET).p2p_port, list[asyncio.StreamWriter]()

    async def call(address: str) -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context, local_addr=(address, 0))
                held.append(writer)
                await reader.read(1000)
            await asyncio.sleep(0.02)

    calling = [asyncio.create_task(call(f"127.0.1.{number}")) for number in range(1, 5)]
    try:
        yield
    finally:
        for task in calling:
            task.cancel()
        await asyncio.gather(*calling, return_exceptions=True)
        for writer in held:
            writer.transport.abort()


def _open_descriptors_count(network: NetworkUnderTest) -> int:
    pid = network.cluster._read_state().pids[TARGET]
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


async def _erased(network: NetworkUnderTest) -> None:
    async with asyncio.timeout(60):
        while True:
            status = await ask_status(network.cluster.config(TARGET))
            if status.clips_erased and not status.outbox_ready and not status.waiting_for:
                return
            await asyncio.sleep(0.1)


async def test_a_custodian_erases_and_restarts_its_worker_while_all_its_ports_are_held(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    ward, config = Ward(intruder), network.cluster.config(TARGET)
    assert TARGET in [node.name for node in intruder.genesis.nodes if node.custodian_key]
    await ward.open()
    clip = ward.clip()
    for node in [node.name for node in intruder.genesis.nodes if node.custodian_key]:
        assert (await ward.upload(clip.upload, node, await intruder.session(ward.robot.identity, node)))[0] == 200
    assert (await intruder.final(ward.record_call(clip)))["ok"]
    before = (await network.status(TARGET))["contracts"]["blocks"]
    clients, neighbour = Crowd("127.0.0.1", config.api_port), Crowd("127.0.0.1", config.operator_port)
    try:
        async with _silent_thief(network):
            await asyncio.gather(
                clients.grow(2 * DESCRIPTORS_COUNT, HALF_A_HEAD), neighbour.grow(2 * DESCRIPTORS_COUNT, HALF_A_HEAD)
            )
            os.kill(before["pid"], signal.SIGKILL)
            await ward.must(ward.owner, "erasure", "request", [clip.upload.record_id], [])
            await _erased(network)
            async with asyncio.timeout(ANSWER_MAX_S):
                assert (await intruder.ask("GET", "/v1/finality", node=TARGET))[0] in {200, 401}
                told = await network.status(TARGET)
            assert told["contracts"]["blocks"]["replaced"] > before["replaced"]
            assert {row["peer"]: row["code"] for row in told["refused_peers"]} == {THIEF: "PEER_SILENT"}
            assert _open_descriptors_count(network) < DESCRIPTORS_COUNT * 9 // 10
    finally:
        clients.leave()
        neighbour.leave()
