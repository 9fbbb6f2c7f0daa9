"""Things are broken on purpose in a running network, and the doctor names each of them."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from typing import Any

import lmdb
from aiohttp import web

from node.storage.lmdb_store import DATA_FILE_NAME
from tests.cluster.commands import blockrobot, must
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_membership import linked


async def _diagnosis(network: NetworkUnderTest) -> tuple[int, set[tuple[str, str]]]:
    """The doctor's exit code and what it found, as (code, node)."""
    code, report = await blockrobot(network, "doctor")
    assert all(finding["next_step"] for finding in report["findings"])
    found = {(finding["code"], finding["node"]) for finding in report["findings"]}
    return code, {finding for finding in found if finding[0] != "DISK_LOW"}


def _pid(network: NetworkUnderTest, name: str) -> int:
    return network.cluster._read_state().pids[name]


async def test_a_sound_network_has_nothing_wrong(network: NetworkUnderTest) -> None:
    await network.finalize("node-1", network.transaction())
    await linked(network, *network.names)
    assert await _diagnosis(network) == (0, set())


async def test_a_killed_node_and_whoever_took_its_port(network: NetworkUnderTest) -> None:
    await linked(network, *network.names)
    network.cluster.kill("node-2")
    assert await _diagnosis(network) == (1, {("NODE_DOWN", "node-2")})
    config = network.cluster.config("node-2")
    with socket.create_server((config.host, config.api_port)):
        assert await _diagnosis(network) == (1, {("NODE_DOWN", "node-2"), ("PORT_TAKEN", "node-2")})


async def test_a_paused_node_is_silent(network: NetworkUnderTest) -> None:
    os.kill(_pid(network, "node-3"), signal.SIGSTOP)
    try:
        code, found = await _diagnosis(network)
    finally:
        os.kill(_pid(network, "node-3"), signal.SIGCONT)
    assert (code, ("NODE_SILENT", "node-3") in found) == (1, True)
    assert ("NODE_DOWN", "node-3") not in found


async def test_a_wrong_clock_is_named_with_its_node(network: NetworkUnderTest) -> None:
    await must(network, "fault", "skew", "node-4", "+1h")
    code, found = await _diagnosis(network)
    assert code == 1
    assert {finding for finding in found if finding[0] == "CLOCK_SKEW"} == {("CLOCK_SKEW", "node-4")}


async def test_keys_that_others_can_read(network: NetworkUnderTest) -> None:
    await linked(network, *network.names)
    path = network.cluster.config("node-1").producer_key_path
    assert path is not None
    path.chmod(0o644)
    assert await _diagnosis(network) == (1, {("KEY_FILE_EXPOSED", "node-1")})


async def test_a_certificate_in_its_last_days_is_a_warning(network: NetworkUnderTest) -> None:
    await must(network, "certificate", "renew", "node-1", "--days", "7")
    code, found = await _diagnosis(network)
    for _ in range(10):  # the node makes its links anew with the new certificate, and misses some until it has
        if code == 0:
            break
        await asyncio.sleep(0.5)
        code, found = await _diagnosis(network)
    assert (code, ("CERTIFICATE_EXPIRES_SOON", "node-1") in found) == (0, True), found


async def test_a_state_that_was_changed_on_disk(network: NetworkUnderTest) -> None:
    await network.finalize("node-1", network.transaction())
    network.cluster.stop("node-3")
    config = network.cluster.config("node-3")
    _change_a_value(str(config.ledger_dir))
    code, found = await _diagnosis(network)
    assert (code, ("LEDGER_DAMAGED", "node-3") in found) == (1, True)
    (config.ledger_dir / DATA_FILE_NAME).write_bytes(b"rubbish" * 1000)
    assert ("LEDGER_DAMAGED", "node-3") in (await _diagnosis(network))[1]
    config.journal_path.unlink()
    assert ("JOURNAL_MISSING", "node-3") in (await _diagnosis(network))[1]


def _change_a_value(folder: str) -> None:
    """Turn a bit of a node's entry, as a failing disk would."""
    with lmdb.open(folder, max_dbs=32) as environment:
        names = []
        with environment.begin() as transaction:
            names = [bytes(name) for name, _ in transaction.cursor()]
        for name in names:
            table = environment.open_db(name, create=False)
            with environment.begin(write=True) as transaction:
                value = transaction.get(b"membership\x00node/node-1", db=table)
                if value is not None:
                    transaction.put(b"membership\x00node/node-1", value[:-1] + bytes([value[-1] ^ 1]), db=table)
                    return
    raise AssertionError("no table holds the node's entry")


async def test_a_node_whose_state_is_another_one(network: NetworkUnderTest) -> None:
    """Somebody answers in a stopped node's place, with another state, another version and a broken disk."""
    await network.finalize("node-1", network.transaction())
    status = await network.status("node-4")
    network.cluster.stop("node-4")
    false = {**status, "state_root": "00" * 32, "version": "9.9.9", "fault": "The journal cannot be written."}
    async with _operator(network.cluster.config("node-4").operator_port, false):
        code, found = await _diagnosis(network)
    assert code == 1
    assert {("STATE_DIVERGED", "node-4"), ("VERSION_DIFFERS", "node-4"), ("NODE_FAULT", "node-4")} <= found
    assert not {finding for finding in found if finding[0] == "STATE_DIVERGED" and finding[1] != "node-4"}


class _operator:  # noqa: N801 - used as a function
    """An operator's listener that says what it is told to."""

    def __init__(self, port: int, status: dict[str, Any]) -> None:
        async def describe(_request: web.Request) -> web.Response:
            return web.json_response(status)

        application = web.Application()
        application.router.add_get("/status", describe)
        self._runner, self._port = web.AppRunner(application), port

    async def __aenter__(self) -> None:
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", self._port).start()

    async def __aexit__(self, *_: object) -> None:
        await self._runner.cleanup()


async def test_nodes_that_were_cut_apart_and_why(network: NetworkUnderTest) -> None:
    """A cut link looks sound until it has to be made again; that it was cut on purpose is said at once."""
    await must(network, "fault", "partition", "node-4")
    assert ("FAULT_ON_PURPOSE", "node-4") in (await _diagnosis(network))[1]
    network.cluster.stop("node-4")
    network.cluster.start("node-4")
    await network.cluster.wait_answering("node-4")
    code, found = await _diagnosis(network)
    assert code == 1
    assert {("LINK_MISSING", "node-1"), ("LINK_MISSING", "node-2"), ("FAULT_ON_PURPOSE", "node-1")} <= found
    await must(network, "fault", "heal")
    await network.cluster.wait_ready()
    for _ in range(100):
        code, found = await _diagnosis(network)
        if not found:
            break
        await asyncio.sleep(0.2)
    assert (code, found) == (0, set())
