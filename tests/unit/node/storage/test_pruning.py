"""Pruning drops bodies, receipts and events and nothing else: what both stores promise."""

from __future__ import annotations

import asyncio

from contracts.state.trie import compute_root
from node.storage.ledger_store import EventCursor, RecentBlock, TransactionLocation
from node.storage.lmdb_store import LmdbStore
from node.storage.lmdb_writing import PRUNED_AT_ONCE_COUNT


def reduce(block: bytes) -> bytes:
    """Keep the first two words, as a node keeps the header."""
    return b" ".join(block.split(b" ")[:2])


async def prune_all(store, below_height):
    while (earliest := await store.prune(below_height, reduce)) < below_height:
        assert earliest > 0
    return earliest


async def test_a_pruned_block_leaves_its_header_its_place_and_its_txids(store, chain):
    blocks = [chain.block() for _ in range(10)]
    await store.commit(blocks, b"proof")
    assert await prune_all(store, 6) == 6
    with store.snapshot() as view:
        assert view.earliest_height == 6
        for height in range(6):
            assert view.block(height) is None
            assert view.receipts(height) is None
            assert view.kept_header(height) == b"block %d" % height
            assert view.block_height(blocks[height].block_id) == height
            assert view.locate(blocks[height].transactions[1][0]) == TransactionLocation(height, 1)
        assert [height for height, _ in view.iter_blocks(0, 100)] == [6, 7, 8, 9]
        assert (view.block(6), view.receipts(6)) == (blocks[6].block_bytes, blocks[6].receipts_bytes)
        assert view.kept_header(6) is None
        assert view.kept_header(-1) is None
        assert view.events(EventCursor(0, 0), 1)[0][0] == EventCursor(6, 0)
        assert {row.height for row in view.recent_txids(0)} == set(range(10))
        assert view.finality == b"proof"
        assert compute_root(view.scan(b"", 10_000)) == view.state_root


async def test_nothing_is_pruned_unless_asked(store, chain):
    await store.commit([chain.block() for _ in range(3)], b"")
    assert await store.prune(0, reduce) == 0
    with store.snapshot() as view:
        assert view.earliest_height == 0
        assert view.block(0) is not None


async def test_the_newest_block_always_stays(store, chain):
    assert await store.prune(5, reduce) == 0
    blocks = [chain.block() for _ in range(4)]
    await store.commit(blocks, b"")
    assert await store.prune(100, reduce) == 3
    with store.snapshot() as view:
        assert view.block(3) == blocks[3].block_bytes
    await store.commit([chain.block()], b"")
    assert await store.prune(2, reduce) == 3


async def test_a_snapshot_keeps_what_is_pruned_meanwhile(store, chain):
    blocks = [chain.block() for _ in range(5)]
    await store.commit(blocks, b"")
    with store.snapshot() as old:
        await store.prune(4, reduce)
        assert old.block(1) == blocks[1].block_bytes
        assert old.earliest_height == 0
        with store.snapshot() as new:
            assert new.block(1) is None


async def test_a_store_goes_on_while_it_is_pruned(store, chain):
    await store.commit([chain.block() for _ in range(20)], b"")
    later = [chain.block() for _ in range(20)]
    await asyncio.gather(*(store.commit([block], b"") for block in later), prune_all(store, 10))
    with store.snapshot() as view:
        assert [height for height, _ in view.iter_blocks(0, 100)] == list(range(10, 40))


async def test_a_long_chain_is_pruned_in_bounded_steps(lmdb_store, chain):
    await lmdb_store.commit([chain.block(size=1) for _ in range(PRUNED_AT_ONCE_COUNT + 20)], b"")
    assert await lmdb_store.prune(PRUNED_AT_ONCE_COUNT + 10, reduce) == PRUNED_AT_ONCE_COUNT
    assert await lmdb_store.prune(PRUNED_AT_ONCE_COUNT + 10, reduce) == PRUNED_AT_ONCE_COUNT + 10


async def test_what_was_pruned_stays_so_over_a_restart(tmp_path, chain):
    store = LmdbStore.create(tmp_path / "ledger")
    await store.commit([chain.block() for _ in range(5)], b"")
    await store.prune(3, reduce)
    await store.close()
    store = LmdbStore.open(tmp_path / "ledger")
    with store.snapshot() as view:
        assert (view.earliest_height, view.kept_header(2)) == (3, b"block 2")
    await store.close()


async def test_the_replay_window_is_read_block_by_block(store, chain):
    blocks = [chain.block(transactions=index % 2) for index in range(4)]
    await store.commit(blocks, b"")
    with store.snapshot() as view:
        window = list(view.iter_recent(blocks[1].timestamp_ms))
    assert window == [RecentBlock(block.height, block.timestamp_ms, tuple(block.transactions)) for block in blocks[1:]]
