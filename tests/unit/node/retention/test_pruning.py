"""What a node drops of its past, and what it says of that."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from network.provisioning.network_layout import create_network
from node.api_adapters import DecodedSnapshot
from node.config import KEEP_BLOCKS_COUNT, KEEP_BLOCKS_MIN_COUNT, config_to_toml, load_config
from node.p2p.wire import BlockBatch, FinalizedRequest
from node.peers.peer_requests import PeerRequests
from node.retention.pruning import (
    PRUNE_SLACK_COUNT,
    PrunedLedger,
    Pruner,
    answer_requests,
    prune_ledger,
    prune_stopped_node,
    request_pruning,
)
from node.retention.retention import BLOCKS_KEPT_MS, highest_prunable
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryStore
from tests.unit.node.written_chain import WrittenChain

DAY_MS = 24 * 3600 * 1000


def written(blocks: int) -> WrittenChain:
    chain = WrittenChain()
    for _ in range(blocks):
        chain.extend({}, transactions=0)
    return chain


@pytest.mark.parametrize(
    ("head", "keep", "followed", "below"),
    [(1000, 300, None, 701), (1000, 300, 1000, 701), (1000, 300, 500, 501), (1000, 300, -1, 0), (100, 300, None, 0)],
)
def test_what_the_custodian_has_not_followed_stays(head: int, keep: int, followed: int | None, below: int) -> None:
    assert highest_prunable(head, keep, followed) == below


async def test_a_block_that_cannot_be_searched_ends_no_housekeeping(monkeypatch: pytest.MonkeyPatch) -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)

    async def fail(*_: object) -> None:
        raise KeyError("status")

    pruner = Pruner(store, 300, lambda: None)
    with monkeypatch.context() as patched:
        patched.setattr("node.retention.retention.Retention.find_cutoff", fail)
        await pruner.run_once()
    await pruner.run_once()


async def test_a_running_node_prunes_in_steps_and_keeps_headers() -> None:
    chain, store = written(400), MemoryStore()
    chain.extend({}, transactions=0, later_ms=BLOCKS_KEPT_MS + DAY_MS)
    await chain.fill(store)
    followed, told = 100, []
    pruner = Pruner(store, 300, lambda: followed)
    pruner.add_listener(told.append)
    await pruner.run_once()
    with store.snapshot() as view:
        assert view.earliest_height == 101
    assert pruner.describe() == {
        "archive": False,
        "earliest_ms": chain.blocks[101].header.timestamp_ms,
        "held_by": "custodian",
    }
    for _ in range(PRUNE_SLACK_COUNT // 2):
        chain.extend({}, transactions=0)
    await chain.fill(store)
    followed = 433
    await pruner.run_once()
    assert (told, pruner.describe()["held_by"]) == ([101], "keep_blocks")
    with store.snapshot() as view:
        assert view.earliest_height == 101
        decoded = DecodedSnapshot(view)
        assert decoded.earliest_height == 101
        assert [decoded.header_bytes(height) for height in (7, 101, 432)] == [
            chain.blocks[height].header_bytes for height in (7, 101, 432)
        ]
        assert decoded.block(7) is None


async def test_young_blocks_stay_and_pruning_ends_at_the_newest_block() -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    await Pruner(store, 1, lambda: None).run_once()
    with store.snapshot() as view:
        assert view.earliest_height == 0
    chain, store = written(5), MemoryStore()
    assert await prune_ledger(store, 100) == 0
    await chain.fill(store)
    assert await prune_ledger(store, 100) == 5


async def test_a_running_node_prunes_when_its_directory_asks_for_it(tmp_path: Path) -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    pruner = Pruner(store, 300, lambda: None)
    await answer_requests(tmp_path, pruner)
    request = request_pruning(tmp_path, 300)
    await answer_requests(tmp_path, pruner)
    assert not request.exists()
    with store.snapshot() as view:
        assert view.earliest_height == 101
    request.write_text("everything")
    await answer_requests(tmp_path, pruner)
    assert not request.exists()
    request_pruning(tmp_path, 1)
    await answer_requests(tmp_path, pruner)
    with store.snapshot() as view:
        assert view.earliest_height == 400 - KEEP_BLOCKS_MIN_COUNT + 1


async def test_a_peer_gets_no_dropped_block_from_what_was_answered_before() -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    requests = PeerRequests(store, lambda _source, _error: None)
    pruner = Pruner(store, 300, lambda: None)
    pruner.add_listener(requests.forget_below)
    old, new = FinalizedRequest(from_height=1, count=32), FinalizedRequest(from_height=300, count=32)
    before = [decode(await requests.read_finalized(each), BlockBatch) for each in (old, new)]
    assert [len(batch.blocks) for batch in before] == [32, 32]
    await pruner.prune_to(300)
    after = [decode(await requests.read_finalized(each), BlockBatch) for each in (old, new)]
    assert [(len(batch.blocks), batch.earliest_height) for batch in after] == [(0, 101), (32, 0)]
    requests.stop()


async def test_an_archive_drops_nothing_old_or_asked_for(tmp_path: Path) -> None:
    chain, store = written(400), MemoryStore()
    chain.extend({}, transactions=0, later_ms=BLOCKS_KEPT_MS + DAY_MS)
    await chain.fill(store)
    pruner = Pruner(store, 0, lambda: None)
    await pruner.run_once()
    request = request_pruning(tmp_path, 300)
    await answer_requests(tmp_path, pruner)
    assert not request.exists()
    with store.snapshot() as view:
        assert view.earliest_height == 0
    assert pruner.describe() == {"archive": True, "earliest_ms": chain.blocks[0].header.timestamp_ms, "held_by": None}


async def test_a_stopped_node_is_pruned_as_far_as_its_custodian_has_come(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=2, organisations=1, base_port=46_500)
    configs = [load_config(tmp_path / "network" / "nodes" / name) for name in ("node-1", "node-2")]
    chain = written(20)
    for config in configs:
        store = LmdbStore.create(config.ledger_dir)
        await chain.fill(store)
        await store.close()
    custodian, other = [await prune_stopped_node(config, 5) for config in configs]
    assert custodian == PrunedLedger(20, 0, held_back_by_custody=True)
    assert other == PrunedLedger(20, 16, held_back_by_custody=False)


def test_the_settings_are_read_from_the_configuration_and_checked(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=2, organisations=1, base_port=46_500, archives=["node-2"])
    data_dir = tmp_path / "network" / "nodes" / "node-1"
    assert load_config(data_dir.with_name("node-2")).archive
    path = data_dir / "node.toml"
    text = path.read_text()
    written = f"keep_blocks = {KEEP_BLOCKS_COUNT}"
    assert written in text
    assert (load_config(data_dir).keep_blocks, load_config(data_dir).archive) == (KEEP_BLOCKS_COUNT, False)
    path.write_text(text.replace(written, "archive = true"))
    assert (load_config(data_dir).keep_blocks, load_config(data_dir).archive) == (KEEP_BLOCKS_COUNT, True)
    path.write_text(text.replace(written, f"keep_blocks = {KEEP_BLOCKS_MIN_COUNT}"))
    config = load_config(data_dir)
    assert config.keep_blocks == KEEP_BLOCKS_MIN_COUNT
    path.write_text(config_to_toml(config))
    assert load_config(data_dir) == config
    for wrong in ("keep_blocks = 5", "keep_blocks = 0", "keep_blocks = true", 'keep_blocks = "all"', "archive = 1"):
        path.write_text(text.replace(written, wrong))
        with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
            load_config(data_dir)
    with pytest.raises(BlockRobotError) as refused:
        create_network(tmp_path / "other", nodes=2, organisations=1, base_port=46_500, archives=["node-3"])
    assert (refused.value.code, (tmp_path / "other").exists()) == ("CONFIGURATION_INVALID", False)
