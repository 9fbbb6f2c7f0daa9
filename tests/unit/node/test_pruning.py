"""What a node drops of its past, and what it says of that."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.layout import create_network
from node.config import KEEP_BLOCKS_MIN_COUNT, config_to_toml, load_config
from node.interface import DecodedSnapshot
from node.pruning import (
    PRUNE_SLACK_COUNT,
    Pruner,
    answer_requests,
    highest_prunable,
    prune_ledger,
    prune_stopped_node,
    request_pruning,
)
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryStore
from tests.unit.node.written_chain import WrittenChain


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


async def test_a_running_node_prunes_in_steps_and_keeps_headers() -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    followed = 100
    pruner = Pruner(store, 300, lambda: followed)
    await pruner.run_once()
    with store.snapshot() as view:
        assert view.earliest_height == 101
    for _ in range(PRUNE_SLACK_COUNT // 2):
        chain.extend({}, transactions=0)
    await chain.fill(store)
    followed = 432
    await pruner.run_once()
    with store.snapshot() as view:
        assert view.earliest_height == 101
        decoded = DecodedSnapshot(view)
        assert decoded.earliest_height == 101
        assert [decoded.header_bytes(height) for height in (7, 101, 432)] == [
            chain.blocks[height].header_bytes for height in (7, 101, 432)
        ]
        assert decoded.block(7) is None


async def test_a_running_node_prunes_when_its_directory_asks_for_it(tmp_path: Path) -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    pruner = Pruner(store, 0, lambda: None)
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


async def test_a_node_that_is_to_keep_everything_prunes_nothing() -> None:
    chain, store = written(400), MemoryStore()
    await chain.fill(store)
    await Pruner(store, 0, lambda: None).run_once()
    with store.snapshot() as view:
        assert view.earliest_height == 0


async def test_pruning_ends_at_the_newest_block() -> None:
    chain, store = written(5), MemoryStore()
    assert await prune_ledger(store, 100) == 0
    await chain.fill(store)
    assert await prune_ledger(store, 100) == 5


async def test_a_stopped_node_is_pruned_as_far_as_its_custodian_has_come(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=2, organisations=1, base_port=46_500)
    configs = [load_config(tmp_path / "network" / "nodes" / name) for name in ("node-1", "node-2")]
    chain = written(20)
    for config in configs:
        store = LmdbStore.create(config.ledger_dir)
        await chain.fill(store)
        await store.close()
    custodian, other = [await prune_stopped_node(config, 5) for config in configs]
    assert custodian == {"height": 20, "earliest_height": 0, "held_back_by_custody": True}
    assert other == {"height": 20, "earliest_height": 16, "held_back_by_custody": False}


def test_the_setting_is_read_from_the_configuration_and_checked(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=46_500)
    data_dir = tmp_path / "network" / "nodes" / "node-1"
    path = data_dir / "node.toml"
    text = path.read_text()
    assert load_config(data_dir).keep_blocks == 0
    path.write_text(text.replace("keep_blocks = 0", f"keep_blocks = {KEEP_BLOCKS_MIN_COUNT}"))
    config = load_config(data_dir)
    assert config.keep_blocks == KEEP_BLOCKS_MIN_COUNT
    path.write_text(config_to_toml(config))
    assert load_config(data_dir) == config
    for wrong in ("5", "-1", "true", '"all"'):
        path.write_text(text.replace("keep_blocks = 0", f"keep_blocks = {wrong}"))
        with pytest.raises(BlockRobotError) as refused:
            load_config(data_dir)
        assert refused.value.code == "CONFIGURATION_INVALID"
