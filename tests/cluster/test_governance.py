"""Organisations govern a running network from the command line: settings, producers, evidence."""

from __future__ import annotations

import asyncio
import time
from typing import Any

from consensus.chain.messages import VOTE_TAG, vote_parts
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from tests.cluster.commands import COMMAND_TIMEOUT_S, blockrobot, must
from tests.cluster.network_under_test import NetworkUnderTest


async def _agreement(network: NetworkUnderTest) -> set[str]:
    """One more transaction, and the block in which each node has it."""
    transaction = network.transaction()
    await network.finalize(network.names[0], transaction)
    return {await network.block_id(name, transaction.txid) for name in network.names}


def _producer_key(network: NetworkUnderTest, name: str) -> PrivateKey:
    return PrivateKey((network.folder / "nodes" / name / "keys" / "producer.key").read_bytes())


async def _producer(network: NetworkUnderTest, name: str) -> dict[str, Any]:
    listed = await must(network, "producer", "list")
    return next(row for row in listed["producers"] if row["node"] == name)


async def test_two_organisations_change_a_setting_of_a_running_network(network: NetworkUnderTest) -> None:
    proposed = await must(network, "settings", "propose", "base_timeout_ms", "700", "--as", "hospital")
    proposal = proposed["proposal"]
    assert (proposed["executed"], proposal["approvals"], proposal["needed"]) == (False, ["hospital"], 2)
    code, refused = await blockrobot(network, "settings", "approve", proposal["id"], "--as", "hospital")
    assert (code, refused["error"]["code"]) == (1, "GOVERNANCE_APPROVED_ALREADY")

    approved = await must(network, "settings", "approve", proposal["id"][:12], "--as", "university")
    assert (approved["executed"], approved["epoch"]) == (True, 1)
    listed = await must(network, "settings", "list")
    assert (listed["epoch"], listed["since_height"]) == (1, approved["height"])
    assert (listed["settings"]["base_timeout_ms"], listed["proposals"]) == (700, [])

    assert len(await _agreement(network)) == 1
    code, refused = await blockrobot(network, "settings", "propose", "production", "manual", "--as", "hospital")
    assert refused["error"]["code"] == "GOVERNANCE_SETTING_REFUSED"
    assert (await must(network, "org", "list"))["majority"] == 2


async def test_a_producer_leaves_and_comes_back_by_votes_and_its_own_word(network: NetworkUnderTest) -> None:
    removed = await must(network, "producer", "remove", "node-4", "--as", "university")
    assert removed["epoch"] == 1, "an organisation may retire its own producer"
    listed = await must(network, "producer", "list")
    assert [row["node"] for row in listed["producers"]] == ["node-1", "node-2", "node-3"]
    assert len(await _agreement(network)) == 1

    await must(network, "producer", "propose", "node-4", "--as", "hospital")
    await must(network, "producer", "approve", "node-4", "--as", "university")
    deadline = time.monotonic() + COMMAND_TIMEOUT_S
    while (row := await _producer(network, "node-4"))["status"] != "producing":
        assert time.monotonic() < deadline, row
        await asyncio.sleep(0.2)
    assert (row["turn"], row["leads"]) == (3, True)
    assert row["ready_height"] > removed["height"]
    assert len(await _agreement(network)) == 1


async def test_evidence_suspends_a_producer_and_is_shown(network: NetworkUnderTest) -> None:
    offender, accuser = _producer_key(network, "node-2"), _producer_key(network, "node-1")
    chain_id = network.genesis.chain_id
    ids = sorted((sha256(b"one"), sha256(b"two")))
    signed = [offender.sign_compact(VOTE_TAG, *vote_parts(chain_id, 0, 5, block_id)) for block_id in ids]
    evidence = ["vote", 0, 5, offender.public_key, ids[0], signed[0], ids[1], signed[1]]

    forged = [*evidence[:7], signed[0]]
    for arguments, code in ((forged, "EVIDENCE_FORGED"), (evidence, "OK"), (evidence, "EVIDENCE_KNOWN")):
        accusation = network.sign(accuser, "producers", "accuse", arguments)
        assert (await network.finalize("node-1", accusation))["receipt"]["code"] == code

    row = await _producer(network, "node-2")
    assert (row["status"], row["turn"], row["leads"]) == ("suspended", 1, False), "of four, it keeps its seat"
    shown = row["evidence"]
    assert (shown["kind"], shown["epoch"], shown["round"], shown["first_id"]) == ("vote", 0, 5, ids[0].hex())
    assert len(await _agreement(network)) == 1
