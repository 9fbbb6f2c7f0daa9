"""What every ledger store promises: one suite, run on the store on disk and on the one in memory."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.trie import EMPTY_ROOT, verify_proof
from contracts.state.trie import compute_root
from contracts.state.view import Overlay
from node.storage.ledger_store import REPLAY_WINDOW_KEPT_MS, EventCursor, TransactionLocation


async def test_a_new_store_is_empty(store):
    assert store.position is None
    with store.snapshot() as view:
        assert view.position is None
        assert view.state_root == EMPTY_ROOT
        assert view.finality == b""
        assert view.get(b"any") is None
        assert view.block(0) is None
        assert list(view.scan(b"", 10)) == []
        assert list(view.iter_blocks(0, 10)) == []
        assert view.events(EventCursor(0, 0), 10) == []
        assert view.recent_txids(0) == []
        verify_proof(EMPTY_ROOT, b"any", None, view.prove(b"any"))


async def test_a_commit_moves_everything_together(store, chain):
    block = chain.block()
    position = await store.commit([block], b"proof 0")
    assert position == store.position == block.position
    with store.snapshot() as view:
        assert view.position == position
        assert view.state_root == block.state_root
        assert view.finality == b"proof 0"
        assert view.block(0) == block.block_bytes
        assert view.receipts(0) == block.receipts_bytes
        assert view.block_height(block.block_id) == 0
        assert view.locate(block.transactions[1][0]) == TransactionLocation(0, 1)


async def test_several_blocks_are_stored_in_one_step(store, chain):
    blocks = [chain.block() for _ in range(5)]
    await store.commit(blocks, b"proof of the last")
    with store.snapshot() as view:
        assert view.position == blocks[-1].position
        assert list(view.iter_blocks(0, 10)) == [(block.height, block.block_bytes) for block in blocks]
        assert compute_root(view.scan(b"", 10_000)) == view.state_root == chain.state.state_root


async def test_commits_that_wait_at_once_are_stored_in_order(store, chain):
    blocks = [chain.block() for _ in range(40)]
    positions = await asyncio.gather(*(store.commit([block], b"%d" % block.height) for block in blocks))
    assert [position.height for position in positions] == list(range(40))
    with store.snapshot() as view:
        assert view.finality == b"39"
        assert compute_root(view.scan(b"", 10_000)) == view.state_root


async def test_the_state_is_what_the_blocks_wrote(store, chain):
    for _ in range(30):
        await store.commit([chain.block()], b"")
    with store.snapshot() as view:
        assert list(view.scan(b"records\x00", 10_000)) == list(chain.state.scan(b"records\x00", 10_000))
        assert list(view.scan(b"records\x001", 7)) == list(chain.state.scan(b"records\x001", 7))
        assert list(view.scan(b"records\x00", 0)) == []
        for path, page in chain.state.pages.items():
            assert view.page(path) == page


async def test_pages_of_the_past_do_not_pile_up(store, chain):
    for _ in range(30):
        await store.commit([chain.block()], b"")
    await store.commit([chain.block(dict.fromkeys(key for key, _ in chain.state.scan(b"", 10_000)))], b"")
    with store.snapshot() as view:
        assert view.state_root == EMPTY_ROOT
        assert view.page(b"") is None
        assert all(view.page(b"%x" % nibble) is None for nibble in range(16))


async def test_proofs_from_a_snapshot_verify_against_its_root(store, chain):
    await store.commit([chain.block({b"records\x00a": b"1", b"records\x00b": b"2"})], b"")
    with store.snapshot() as view:
        verify_proof(view.state_root, b"records\x00a", b"1", view.prove(b"records\x00a"))
        verify_proof(view.state_root, b"records\x00c", None, view.prove(b"records\x00c"))


async def test_a_snapshot_does_not_change_under_its_reader(store, chain):
    first = chain.block({b"key": b"before", b"gone": b"later"})
    await store.commit([first], b"first")
    with store.snapshot() as old:
        scan = old.scan(b"", 10)
        assert next(scan) == (b"gone", b"later")
        await store.commit([chain.block({b"key": b"after", b"gone": None})], b"second")
        assert next(scan) == (b"key", b"before")
        assert (old.get(b"key"), old.get(b"gone"), old.finality) == (b"before", b"later", b"first")
        assert old.position == first.position
        assert old.block(1) is None
        verify_proof(old.state_root, b"key", b"before", old.prove(b"key"))
        with store.snapshot() as new:
            assert (new.get(b"key"), new.get(b"gone"), new.finality) == (b"after", None, b"second")


async def test_blocks_can_be_executed_on_a_snapshot(store, chain):
    await store.commit([chain.block()], b"")
    with store.snapshot() as view:
        overlay = Overlay.apply(view, {b"records\x00new": b"n"})
        assert overlay.get(b"records\x00new") == b"n"
        verify_proof(overlay.state_root, b"records\x00new", b"n", overlay.prove(b"records\x00new"))


async def test_a_boundary_brings_the_proof_of_the_epoch_that_it_begins(store, chain):
    await store.commit([chain.block(), replace(chain.block(), epoch_proof_bytes=b"proof of epoch 1")], b"")
    await store.commit([chain.block()], b"")
    with store.snapshot() as before:
        await store.commit([replace(chain.block(), epoch_proof_bytes=b"proof of epoch 2"), chain.block()], b"")
        assert before.epoch_proof(1) == b"proof of epoch 1"
        assert before.epoch_proof(2) is None
    with store.snapshot() as view:
        assert [view.epoch_proof(number) for number in (-1, 0, 3)] == [None, None, None]
        assert view.epoch_proof(1) == b"proof of epoch 1"
        assert view.epoch_proof(2) == b"proof of epoch 2"


async def test_blocks_that_do_not_follow_are_refused_and_leave_no_trace(store, chain):
    first, second, third = chain.block(), chain.block(), chain.block()
    for wrong in ([second], [first, third], [first, first], []):
        with pytest.raises(ValueError, match="block"):
            await store.commit(wrong, b"wrong")
    assert store.position is None
    await store.commit([first], b"")
    with pytest.raises(ValueError, match="expects block 1"):
        await store.commit([first], b"again")
    await store.commit([second, third], b"right")
    with store.snapshot() as view:
        assert view.finality == b"right"


async def test_a_block_that_is_not_later_or_names_no_txids_is_refused(store, chain):
    await store.commit([chain.block()], b"")
    with pytest.raises(ValueError, match="not later"):
        await store.commit([chain.block(later_ms=0)], b"")
    odd = chain.block()
    with pytest.raises(ValueError, match="txid"):
        await store.commit(
            [type(odd)(1, odd.block_id, b"", b"", odd.timestamp_ms, odd.state_root, [(b"short", 1)])], b""
        )
    assert store.position.height == 0


async def test_one_commit_out_of_order_does_not_harm_its_neighbours(store, chain):
    blocks = [chain.block() for _ in range(3)]
    outcomes = await asyncio.gather(
        store.commit([blocks[0]], b""),
        store.commit([blocks[2]], b"too early"),
        store.commit([blocks[1]], b""),
        return_exceptions=True,
    )
    assert [type(outcome) for outcome in outcomes][1] is ValueError
    assert store.position == blocks[1].position


async def test_the_replay_window_is_read_by_block_timestamps(store, chain):
    blocks = [chain.block(later_ms=1000) for _ in range(6)]
    await store.commit(blocks, b"")
    with store.snapshot() as view:
        recent = view.recent_txids(blocks[3].timestamp_ms)
    expected = [(txid, block, until) for block in blocks[3:] for txid, until in block.transactions]
    assert [(item.txid, item.height, item.timestamp_ms, item.valid_until_ms) for item in recent] == [
        (txid, block.height, block.timestamp_ms, until) for txid, block, until in expected
    ]


async def test_the_replay_window_forgets_what_can_no_longer_be_replayed(store, chain):
    old, edge = chain.block(), chain.block()
    late = chain.block(later_ms=REPLAY_WINDOW_KEPT_MS)
    await store.commit([old, edge], b"")
    await store.commit([late], b"")
    with store.snapshot() as view:
        assert {item.height for item in view.recent_txids(0)} == {1, 2}
        assert view.locate(old.transactions[0][0]) == TransactionLocation(0, 0)


async def test_events_are_read_on_from_a_cursor_without_loss_or_repetition(store, chain):
    blocks = [chain.block(events=count) for count in (2, 0, 3, 1)]
    await store.commit(blocks, b"")
    with store.snapshot() as view:
        everything = view.events(EventCursor(0, 0), 100)
        assert [event for _, event in everything] == [event for block in blocks for event in block.events]
        read, cursor = [], EventCursor(0, 0)
        while batch := view.events(cursor, 2):
            read += batch
            cursor = batch[-1][0].next
        assert read == everything
        assert view.events(EventCursor(9, 0), 10) == []
        assert view.events(EventCursor(0, 0), 0) == []


async def test_blocks_are_iterated_from_a_height_within_a_limit(store, chain):
    blocks = [chain.block() for _ in range(6)]
    await store.commit(blocks, b"")
    with store.snapshot() as view:
        assert [height for height, _ in view.iter_blocks(2, 3)] == [2, 3, 4]
        assert [height for height, _ in view.iter_blocks(5, 10)] == [5]
        assert list(view.iter_blocks(6, 10)) == []
        assert list(view.iter_blocks(0, 0)) == []
        assert (view.block(6), view.block(-1), view.receipts(-1), view.block_height(b"?" * 32)) == (None,) * 4


async def test_a_large_block_is_kept_whole(store, chain):
    block = chain.block(size=3_000_000)
    await store.commit([block], b"")
    with store.snapshot() as view:
        assert view.block(0) == block.block_bytes


async def test_closed_snapshots_and_stores_refuse_and_closing_twice_is_harmless(store, chain):
    await store.commit([chain.block()], b"")
    view = store.snapshot()
    view.close()
    view.close()
    with pytest.raises(ValueError, match="closed"):
        view.get(b"key")
    await store.close()
    await store.close()
    with pytest.raises(BlockRobotError, match=r"^STORAGE_UNWRITABLE:"):
        await store.commit([chain.block()], b"")
    with pytest.raises(ValueError, match="closed"):
        store.snapshot()


async def test_a_cancelled_caller_does_not_take_the_block_back(store, chain):
    block, following = chain.block(), chain.block()
    task = asyncio.ensure_future(store.commit([block], b""))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert await store.commit([following], b"") == following.position
