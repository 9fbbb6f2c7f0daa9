"""Nodes come, go and renew their certificates while the network runs; nobody else is restarted."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import Callable
from typing import Any

import aiohttp
import pytest

from consensus.primitives.encoding import decode
from network.provisioning.node_certificates import get_authority, read_report, renew
from node.config import load_config
from node.p2p.wire import FrameDecoder, FrameKind, Refusal
from tests.cluster.commands import agree, blockrobot, must
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest

FOUR = ["node-1", "node-2", "node-3", "node-4"]


async def until(network: NetworkUnderTest, name: str, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Wait until a node's status is as wanted; return it."""
    deadline = time.monotonic() + FINAL_TIMEOUT_S
    while True:
        status = await network.status(name)
        if status and condition(status):
            return status
        assert time.monotonic() < deadline, f"{name}: {status}"
        await asyncio.sleep(0.05)


async def linked(network: NetworkUnderTest, *names: str) -> None:
    """Wait until each of these nodes is linked with exactly the others."""
    for name in names:
        await until(network, name, lambda status, name=name: status["peers"] == sorted({*names} - {name}))


async def uptimes(network: NetworkUnderTest, names: list[str]) -> dict[str, float]:
    return {name: (await network.status(name))["uptime_s"] for name in names}


def refusals(status: dict[str, Any], field: str = "refused_peers") -> dict[str, str]:
    return {row["peer"]: row["code"] for row in status[field]}


async def add_node(network: NetworkUnderTest, name: str) -> None:
    """Make a node of the hospital, have it agreed on, and start it."""
    made = await must(network, "node", "init", name, "--organisation", "hospital")
    await agree(network, "add-node", "--from", made["entry"])
    network.cluster.configs[name] = load_config(network.folder / "nodes" / name)
    network.cluster.start(name)
    await network.cluster.wait_answering(name)


async def knock_as(network: NetworkUnderTest, name: str, target: str) -> None:
    """Dial a node with another one's certificate; nothing may come back but the reason why not."""
    config = network.cluster.config(name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(config.tls_certificate_path, config.tls_key_path)
    port = network.cluster.config(target).p2p_port
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    answer = await asyncio.wait_for(reader.read(), FINAL_TIMEOUT_S)
    writer.close()
    frames = list(FrameDecoder().feed(answer))
    assert [kind for kind, _ in frames] == [FrameKind.REFUSAL]
    assert decode(frames[0][1], Refusal).code == "PEER_REMOVED"


async def test_a_node_joins_follows_and_is_removed_again(network: NetworkUnderTest) -> None:
    began = await uptimes(network, FOUR)
    await network.finalize("node-1", network.transaction())
    await add_node(network, "node-5")
    await linked(network, *FOUR, "node-5")
    status = await until(network, "node-5", lambda status: status["membership"] == "active")
    assert (status["organisation"], status["problem"]) == ("hospital", None)
    transaction = network.transaction()
    await network.finalize("node-2", transaction)
    height = (await network.status("node-2"))["finalized_height"]
    await network.wait_height("node-5", height)
    place = network.cluster.config("node-5")
    async with network.http.get(
        f"http://127.0.0.1:{place.api_port}/v1/transactions/{transaction.txid.hex()}"
    ) as answer:
        assert (await answer.json())["status"] == "finalized"

    removed = await agree(network, "remove-node", "node-5")
    for name in FOUR:
        status = await until(network, name, lambda status: status["directory_height"] >= removed["height"])
        assert "node-5" not in status["peers"]
    status = await until(network, "node-5", lambda status: not status["peers"])
    assert set(refusals(status, "refused_by").values()) <= {"PEER_REMOVED"}
    network.cluster.stop("node-5")
    network.cluster.start("node-5")
    await network.cluster.wait_answering("node-5")
    status = await until(network, "node-5", lambda status: status["problem"] is not None)
    assert (status["problem"]["code"], status["membership"], status["peers"]) == ("NODE_REMOVED", "removed", [])
    await knock_as(network, "node-5", "node-2")
    await until(network, "node-2", lambda status: refusals(status).get("node-5") == "PEER_REMOVED")
    await network.finalize("node-3", network.transaction())
    now = await uptimes(network, FOUR)
    assert all(now[name] > began[name] for name in FOUR), "a node was restarted"


async def test_a_removed_producer_is_cut_off_and_the_others_go_on(network: NetworkUnderTest) -> None:
    """Three of four stay: its votes count no more from the next epoch on, its certificate from that very height."""
    await network.finalize("node-1", network.transaction())
    removed = await agree(network, "remove-node", "node-4")
    left = FOUR[:3]
    for name in left:
        status = await until(network, name, lambda status: status["epoch"] == removed["epoch"])
        assert "node-4" not in status["peers"]
    await linked(network, *left)
    for name in left:
        await network.finalize(name, network.transaction())
    status = await until(network, "node-4", lambda status: not status["peers"])
    assert set(refusals(status, "refused_by").values()) <= {"PEER_REMOVED"}
    assert len({status["state_root"] for status in await network.same_height(left)}) == 1
    network.cluster.stop("node-4")
    code, report = await blockrobot(network, "doctor")
    found = {finding["code"] for finding in report["findings"] if finding["node"] == "node-4"}
    assert (code, found) == (0, {"NODE_REMOVED"}), report


async def test_a_certificate_is_renewed_on_a_running_node_and_the_old_one_revoked(network: NetworkUnderTest) -> None:
    began = await uptimes(network, FOUR)
    old = (await network.status("node-3"))["certificate"]["serial"]
    renewed = await must(network, "certificate", "renew", "node-3", "--new-key")
    await until(network, "node-3", lambda status: status["certificate"]["serial"] == renewed["serial"] != old)
    await asyncio.sleep(1.5)  # links are renewed one by one, a quarter of a second apart
    await linked(network, *FOUR)
    await must(network, "certificate", "revoke", "--serial", old, "--as", "hospital")
    await network.finalize("node-3", network.transaction())
    await linked(network, *FOUR)
    listed = await must(network, "certificate", "list")
    assert {row["state"] for row in listed["certificates"]} == {"valid"}
    assert (await uptimes(network, FOUR))["node-3"] > began["node-3"]


@pytest.mark.smoke
async def test_a_revoked_certificate_cuts_its_node_off_until_it_has_a_new_one(network: NetworkUnderTest) -> None:
    await must(network, "certificate", "revoke", "node-2", "--as", "university")
    status = await until(network, "node-2", lambda status: bool(status["refused_by"]) and not status["peers"])
    assert set(refusals(status, "refused_by").values()) == {"PEER_CERTIFICATE_REVOKED"}
    await network.finalize("node-1", network.transaction())
    await until(network, "node-1", lambda status: refusals(status).get("node-2") == "PEER_CERTIFICATE_REVOKED")
    await must(network, "certificate", "renew", "node-2", "--new-key")
    await linked(network, *FOUR)
    await network.finalize("node-2", network.transaction())


async def test_an_expired_certificate_does_not_brick_a_node(network: NetworkUnderTest) -> None:
    """It starts, serves what it has, says what is wrong, and takes part again as soon as it has a new one."""
    transaction = network.transaction()
    await network.finalize("node-3", transaction)
    await network.block_id("node-3", transaction.txid)
    network.cluster.stop("node-3")
    config = network.cluster.config("node-3")
    renew(config, get_authority(network.folder, "hospital"), days=-1)
    network.cluster.start("node-3")
    await network.cluster.wait_answering("node-3")

    status = await until(network, "node-3", lambda status: status["problem"] is not None)
    assert status["problem"]["code"] == "CERTIFICATE_EXPIRED"
    assert "blockrobot certificate renew" in status["problem"]["next_step"]
    assert (status["ready"], status["peers"]) == (False, [])
    async with network.http.get(f"http://127.0.0.1:{config.operator_port}/readyz") as ready:
        assert (ready.status, (await ready.json())["code"]) == (503, "CERTIFICATE_EXPIRED")
    place = await network.place("node-3", transaction.txid, wait_ms=0)
    assert place["status"] == "finalized"
    assert "certificate_expired" in config.log_path.read_text(encoding="utf-8")

    await network.finalize("node-1", network.transaction())
    await until(network, "node-1", lambda status: refusals(status).get("node-3") == "PEER_CERTIFICATE_EXPIRED")
    _, report = await blockrobot(network, "doctor")
    found = {(finding["code"], finding["node"]) for finding in report["findings"]}
    assert {("CERTIFICATE_EXPIRED", "node-3"), ("PEER_REFUSED", "node-3")} <= found

    await must(network, "certificate", "renew", "node-3")
    await linked(network, *FOUR)
    await network.cluster.wait_ready(["node-3"])
    assert read_report(config).trouble == ""
    await network.finalize("node-3", network.transaction())


async def test_up_does_not_wait_for_a_node_that_was_not_added_yet(network: NetworkUnderTest) -> None:
    made = await must(network, "node", "init", "node-5", "--organisation", "university")
    network.cluster.configs["node-5"] = load_config(network.folder / "nodes" / "node-5")
    network.cluster.start("node-5")
    await network.cluster.wait_ready()
    status = await until(network, "node-5", lambda status: status["membership"] == "unknown")
    assert status["peers"] == []
    code, answer = await blockrobot(network, "node", "init", "node-5", "--organisation", "university")
    assert (code, answer["error"]["code"]) == (1, "NODE_EXISTS")
    assert made["next_steps"]
    with_problem = await blockrobot(network, "doctor")
    assert ("NODE_NOT_ADDED", "node-5") in {(row["code"], row["node"]) for row in with_problem[1]["findings"]}


async def test_reads_of_a_node_without_peers_need_no_peers(network: NetworkUnderTest) -> None:
    """The genesis document and a known transaction are answered by a node that nobody talks to."""
    transaction = network.transaction()
    await network.finalize("node-2", transaction)
    await network.block_id("node-2", transaction.txid)
    for name in ("node-1", "node-3", "node-4"):
        network.cluster.kill(name)
    await until(network, "node-2", lambda status: not status["peers"])
    async with (
        aiohttp.ClientSession() as session,
        session.get(network.genesis.node("node-2").api_url + "/v1/genesis") as got,
    ):
        assert got.status == 200
    assert (await network.place("node-2", transaction.txid, wait_ms=0))["status"] == "finalized"
