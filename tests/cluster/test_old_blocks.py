"""A year passes: nodes drop old blocks, an archive keeps them, the owner of a receipt proves it without any of them."""

from __future__ import annotations

import asyncio
import secrets
import time
from pathlib import Path
from typing import Any

import pytest

from clients.registrar.registrar import Registrar
from clients.sdk.network_client import NetworkClient
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.store.kept_proofs import read_kept
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.records.owner_keys import open_visit_keys
from network.faults.actions import FillDisk, Skew
from node.config import KEEP_BLOCKS_COUNT, KEEP_BLOCKS_MIN_COUNT
from node.retention.pruning import PRUNE_SLACK_COUNT
from node.retention.retention import BLOCKS_KEPT_MS
from tests.cluster.commands import run
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest
from tests.cluster.story import Client, Story
from tests.cluster.test_catching_up import assert_same, forget_chain, log_of, make_blocks, wait_caught_up
from tests.world.dicts import CHEAP

YEAR_MS = BLOCKS_KEPT_MS + 24 * 3600 * 1000
PRUNED_TIMEOUT_S = 90.0


def set_keeping(network: NetworkUnderTest, name: str, kept: str) -> None:
    path = network.cluster.config(name).data_dir / "node.toml"
    lines = [line for line in path.read_text().splitlines() if not line.startswith(("keep_blocks", "archive"))]
    path.write_text("\n".join(lines).replace("[storage]", f"[storage]\n{kept}") + "\n")


async def say_and_erase(network: NetworkUnderTest, wallet: Wallet) -> bytes:
    """Register, say a word on consent, be recorded and have it erased; return the erasure's id."""
    desk = Registrar(network.folder / "organisations" / network.genesis.organisations[0].name, network.genesis)
    await wallet.register(desk.issue("0A0B0C0D", "subject"), ["demo"])
    await ConsentClient(wallet).refuse(["care"], [])
    story = Story(network, lambda _name, _value: None)
    robot = Client("node-1", "robot", network, story.history)
    try:
        await robot.enrol()
        visit = open_visit_keys(
            secrets.token_bytes(32),
            wallet.keys.view.public_key,
            wallet.keys.spend.public_key,
            chain_id=network.genesis.chain_id,
            robot=robot.key.public_key,
        )
        opening = [visit.owner, visit.ephemeral, visit.view_tag, robot.bucket_ms, "demo"]
        await robot.client.call(robot.key, "records", "open_visit", opening)
        robot.owner = visit.owner
        await robot.record()
    finally:
        await robot.client.close()
    (known,) = await wallet.scan()
    erasing = ErasureClient(wallet)
    ids = await erasing.request(known, [story.history.writes[-1].record_id], [])
    (report,) = await erasing.wait_complete([(known, ids)])
    return report.erasure_id


async def let_a_year_pass(story: Story) -> None:
    """All clocks jump; a block of the new time becomes final."""
    network = story.network
    await story.do(*(Skew(name, YEAR_MS) for name in story.names))
    for _ in range(4):
        until_ms = time.time_ns() // 1_000_000 + YEAR_MS + 120_000
        await network.finalize("node-2", network.transaction(valid_until_ms=until_ms))


async def wait_pruned(story: Story, name: str) -> dict[str, Any]:
    """Wait until a node has dropped all that it may; return its status."""
    return await story.wait_until(
        name,
        lambda said: (
            said.get("earliest_height", 0) > said.get("finalized_height", 0) - KEEP_BLOCKS_MIN_COUNT - PRUNE_SLACK_COUNT
        ),
        PRUNED_TIMEOUT_S,
    )


async def ask(network: NetworkUnderTest, name: str, txid: bytes) -> dict[str, Any]:
    async with network.http.get(f"{network.url(name)}/v1/transactions/{txid.hex()}?evidence=1") as response:
        answer: dict[str, Any] = await response.json(content_type=None)
        return answer


@pytest.mark.timeout(600)
async def test_old_blocks_go_an_archive_keeps_them_and_receipts_hold_without_them(tmp_path: Path) -> None:
    network = NetworkUnderTest(tmp_path / "network", nodes=4)
    for name in network.names:
        assert f"keep_blocks = {KEEP_BLOCKS_COUNT}" in (network.cluster.config(name).data_dir / "node.toml").read_text()
        set_keeping(network, name, f"keep_blocks = {KEEP_BLOCKS_MIN_COUNT}")
    set_keeping(network, "node-3", f"archive = true\nkeep_blocks = {KEEP_BLOCKS_MIN_COUNT}")
    story = Story(network, lambda _name, _value: None)
    home = tmp_path / "home"
    (home / "wallets").mkdir(parents=True)
    (home / "passphrase").write_text("tea\n")
    try:
        await network.start()
        store = Keystore.create(home / "wallets" / "default.wallet", draw_words(), "tea", CHEAP)
        async with Wallet(store, network.genesis) as wallet:
            erasure_id = await say_and_erase(network, wallet)
        kept_proofs = [read_kept(store.content, txid) for txid in store.content.proofs]
        old = [decode_transaction(bytes.fromhex(each.transaction)) for each in kept_proofs if each is not None]
        assert erasure_id in {transaction.txid for transaction in old}

        # One custodian cannot follow any more: nothing goes that it has not followed.
        await story.do(FillDisk("node-1", "custody"))
        reached = (await network.status("node-1"))["finalized_height"]
        await make_blocks(network, reached + KEEP_BLOCKS_MIN_COUNT + 2 * PRUNE_SLACK_COUNT)
        await let_a_year_pass(story)
        said = await story.wait_until(
            "node-1", lambda said: said["blocks_kept"]["held_by"] == "custodian", PRUNED_TIMEOUT_S
        )
        assert said["earliest_height"] <= said["custody_checkpoint"] + 1
        await story.do(FillDisk("node-1", "custody", is_full=False))

        # The others have dropped them, and so does it once it has followed; the archive has not, and is named.
        for name in ("node-1", "node-2", "node-4"):
            assert not (await wait_pruned(story, name))["blocks_kept"]["archive"]
        kept = (await network.status("node-3"))["blocks_kept"]
        assert (kept["archive"], (await network.status("node-3"))["earliest_height"]) == (True, 0)
        deadline_s = time.monotonic() + FINAL_TIMEOUT_S
        while not (problem := await ask(network, "node-2", erasure_id))["detail"].endswith(" on. node-3 keeps it."):
            assert time.monotonic() < deadline_s, problem
            await asyncio.sleep(0.1)
        assert problem["code"] == "BLOCK_PRUNED"
        async with NetworkClient(network.genesis, first="node-2") as client:
            assert (await client.wait_final(erasure_id)).ok

        # What stood in a dropped block is not taken again, by anybody.
        for name in ("node-2", "node-3"):
            for transaction in old:
                (result,) = await network.submit(name, [transaction])
                assert result["error"]["code"] in {"TRANSACTION_EXPIRED", "TRANSACTION_REPLAYED"}

        # Without an archive nobody has them, and a newcomer joins all the same.
        network.cluster.stop("node-3")
        set_keeping(network, "node-3", f"keep_blocks = {KEEP_BLOCKS_MIN_COUNT}")
        network.cluster.start("node-3")
        await network.cluster.wait_ready(["node-3"])
        await story.do(Skew("node-3", YEAR_MS))
        await wait_pruned(story, "node-3")
        async with NetworkClient(network.genesis, first="node-2") as client:
            with pytest.raises(BlockRobotError) as refused:
                await client.wait_final(erasure_id)
            assert refused.value.code == "BLOCK_PRUNED"
        network.cluster.stop("node-4")
        forget_chain(network, "node-4")
        network.cluster.start("node-4")
        await network.cluster.wait_answering("node-4")
        await story.do(Skew("node-4", YEAR_MS))
        status = await wait_caught_up(network, "node-4", PRUNED_TIMEOUT_S)
        assert status["earliest_height"] > reached
        assert "snapshot_ready" in {line["event"] for line in log_of(network, "node-4")}
        await assert_same(network, "node-2", "node-3", "node-4")
    finally:
        await story.close()
        await network.close()

    # No node runs: the wallet proves the old receipts by itself.
    genesis = network.folder / "genesis.json"
    code, answer = await run("wallet", "--genesis", genesis, "receipts", "--json", home=home)
    assert (code, answer["problems"]) == (0, [])
    assert [row["kind"] for row in answer["receipts"]] == ["registration", "refused", "erasure"]
    erased = answer["receipts"][-1]
    assert erased["txid"] == erasure_id.hex()
    custodians = {node.custodian_key.hex() for node in network.genesis.custodians}
    assert {each["custodian"] for each in erased["confirmed"]} == custodians
