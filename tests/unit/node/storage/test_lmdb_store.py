"""What the ledger on disk does beyond the promises of every store: reopening, refusing, growing, noticing damage."""

from __future__ import annotations

import asyncio
import os
import threading

import lmdb
import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.trie import EMPTY_ROOT
from contracts.state.trie import compute_root
from node.storage import lmdb_store as module
from node.storage.directory_lock import DirectoryLock
from node.storage.ledger_store import LedgerStore
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryStore


def code_of(call, *arguments, **options) -> str:
    with pytest.raises(BlockRobotError) as caught:
        call(*arguments, **options)
    return caught.value.code


async def filled(directory, chain, count=20, **options) -> None:
    store = LmdbStore.create(directory, **options)
    for _ in range(count):
        await store.commit([chain.block()], b"proof")
    await store.close()


def test_both_stores_have_the_protocol_of_a_ledger_store(tmp_path):
    stores: list[LedgerStore] = [MemoryStore(), LmdbStore.create(tmp_path)]
    asyncio.run(stores[1].close())
    assert all(store.position is None for store in stores)


async def test_a_ledger_is_the_same_after_it_was_closed(tmp_path, chain):
    await filled(tmp_path, chain)
    store = LmdbStore.open(tmp_path)
    assert store.position == chain.blocks[-1].position
    with store.snapshot() as view:
        assert list(view.scan(b"", 10_000)) == list(chain.state.scan(b"", 10_000))
        assert view.finality == b"proof"
    await store.commit([chain.block()], b"more")
    await store.close()


async def test_waiting_commits_are_finished_before_the_store_closes(tmp_path, chain):
    store = LmdbStore.create(tmp_path)
    tasks = [asyncio.ensure_future(store.commit([chain.block()], b"")) for _ in range(30)]
    await asyncio.sleep(0)
    await store.close()
    assert [position.height for position in await asyncio.gather(*tasks)] == list(range(30))
    again = LmdbStore.open(tmp_path)
    assert again.position.height == 29
    await again.close()


async def test_a_directory_has_one_owner_at_a_time(tmp_path):
    store = LmdbStore.create(tmp_path)
    assert code_of(LmdbStore.open, tmp_path) == "DATA_DIRECTORY_IN_USE"
    await store.close()
    again = LmdbStore.open(tmp_path)
    await again.close()
    lock = DirectoryLock(tmp_path)
    assert code_of(DirectoryLock, tmp_path) == "DATA_DIRECTORY_IN_USE"
    lock.release()
    lock.release()
    DirectoryLock(tmp_path).release()
    assert code_of(DirectoryLock, tmp_path / "missing") == "DATA_DIRECTORY_INVALID"


async def test_a_ledger_is_never_made_over_another_nor_opened_in_another_format(tmp_path, chain):
    await filled(tmp_path, chain, 1)
    assert code_of(LmdbStore.create, tmp_path) == "DATA_DIRECTORY_INVALID"
    store = LmdbStore.open(tmp_path)
    assert store.position.height == 0
    await store.close()
    with lmdb.open(str(tmp_path), max_dbs=16, map_size=1 << 24) as environment:
        meta = environment.open_db(b"meta")
        with environment.begin(write=True) as transaction:
            transaction.put(b"format", b"blockrobot-ledger/9", db=meta)
    with pytest.raises(BlockRobotError, match="blockrobot-ledger/9") as caught:
        LmdbStore.open(tmp_path)
    assert caught.value.code == "DATA_DIRECTORY_INVALID"


def test_what_is_no_ledger_is_named_or_damage_and_opening_makes_nothing(tmp_path):
    assert code_of(LmdbStore.open, tmp_path) == "DATA_DIRECTORY_INVALID"
    assert code_of(LmdbStore.open, tmp_path / "missing") == "DATA_DIRECTORY_INVALID"
    assert list(tmp_path.iterdir()) == []
    with lmdb.open(str(tmp_path)) as environment, environment.begin(write=True) as transaction:
        transaction.put(b"some", b"thing")
    assert code_of(LmdbStore.open, tmp_path) == "DATA_DIRECTORY_INVALID"
    (tmp_path / "data.mdb").write_bytes(b"garbage " * 4096)
    assert code_of(LmdbStore.open, tmp_path) == "STORAGE_DAMAGED"
    assert code_of(LmdbStore.open, tmp_path) == "STORAGE_DAMAGED"


@pytest.mark.parametrize("leftover", ["empty file", "empty database"])
async def test_a_ledger_whose_making_was_cut_off_is_made_to_the_end(tmp_path, chain, leftover):
    if leftover == "empty file":
        (tmp_path / "data.mdb").touch()
    else:
        lmdb.open(str(tmp_path), max_dbs=16).close()
    store = LmdbStore.open(tmp_path)
    assert store.position is None
    await store.commit([chain.block()], b"")
    await store.close()
    again = LmdbStore.open(tmp_path)
    assert again.position.height == 0
    await again.close()


async def test_every_commit_is_synced_before_it_is_reported(lmdb_store):
    flags = lmdb_store._environment.flags()
    assert flags["sync"]
    assert flags["metasync"]
    assert not flags["map_async"]


async def test_the_disk_is_never_touched_on_the_event_loop(lmdb_store, chain, monkeypatch):
    threads = []
    write = lmdb_store._write_growing
    monkeypatch.setattr(
        lmdb_store, "_write_growing", lambda commits: (threads.append(threading.current_thread()), write(commits))
    )
    await lmdb_store.commit([chain.block()], b"")
    assert [thread.name for thread in threads] == ["ledger-writer"]


async def test_a_state_that_is_not_of_the_newest_block_is_damage(tmp_path, chain):
    await filled(tmp_path, chain, 3)
    with lmdb.open(str(tmp_path), max_dbs=16, map_size=1 << 24) as environment:
        pages = environment.open_db(b"pages")
        with environment.begin(write=True) as transaction:
            transaction.delete(b"/", db=pages)
    assert code_of(LmdbStore.open, tmp_path) == "STORAGE_DAMAGED"


@pytest.mark.parametrize("kept", [0.4, 0.7, 0.9])
async def test_a_file_that_was_cut_short_is_damage_and_kills_nobody(tmp_path, chain, kept):
    await filled(tmp_path, chain)
    path = tmp_path / "data.mdb"
    os.truncate(path, int(path.stat().st_size * kept) // 4096 * 4096)
    assert code_of(LmdbStore.open, tmp_path) == "STORAGE_DAMAGED"


async def test_missing_pages_that_nothing_refers_to_are_no_damage(tmp_path, chain, monkeypatch):
    await filled(tmp_path, chain)
    monkeypatch.setattr(module, "_fill_up", lambda environment, path: True)
    store = LmdbStore.open(tmp_path)
    assert store.position == chain.blocks[-1].position
    await store.close()


async def test_the_map_grows_when_it_is_full(tmp_path, chain):
    store = LmdbStore.create(tmp_path, map_size_bytes=1 << 20)
    for _ in range(40):
        await store.commit([chain.block(size=100_000)], b"")
    with store.snapshot() as view:
        assert compute_root(view.scan(b"", 10_000)) == chain.state.state_root
        assert [data for _, data in view.iter_blocks(0, 100)] == [block.block_bytes for block in chain.blocks]
    await store.close()


async def test_the_map_does_not_move_under_an_open_snapshot(tmp_path, chain, monkeypatch):
    monkeypatch.setattr(module, "GROWTH_WAIT_MAX_MS", 1)
    store = LmdbStore.create(tmp_path, map_size_bytes=1 << 20)
    await store.commit([chain.block()], b"")
    large = chain.block(size=2_000_000)
    with store.snapshot() as view:
        with pytest.raises(BlockRobotError, match=r"^STORAGE_BUSY:"):
            await store.commit([large], b"")
        assert view.block(0) == chain.blocks[0].block_bytes
    assert await store.commit([large], b"") == large.position
    await store.close()


async def test_a_store_at_its_largest_size_refuses_and_still_serves_reads(tmp_path, chain):
    store = LmdbStore.create(tmp_path, map_size_bytes=1 << 20, size_max_bytes=1 << 20)
    await store.commit([chain.block()], b"kept")
    with pytest.raises(BlockRobotError, match=r"^STORAGE_FULL:"):
        await store.commit([chain.block(size=2_000_000)], b"too large")
    assert store.position == chain.blocks[0].position
    with store.snapshot() as view:
        assert view.finality == b"kept"
        assert view.block(1) is None
    await store.close()


async def test_a_block_that_cannot_be_written_does_not_harm_the_one_before_it(lmdb_store, chain):
    good, bad = chain.block(), chain.block({b"k" * 600: b"a key longer than the table takes"})
    outcomes = await asyncio.gather(
        lmdb_store.commit([good], b"good"), lmdb_store.commit([bad], b"bad"), return_exceptions=True
    )
    assert outcomes[0] == good.position
    assert outcomes[1].code == "STORAGE_UNWRITABLE"
    with lmdb_store.snapshot() as view:
        assert (view.position, view.finality) == (good.position, b"good")


async def test_too_many_snapshots_are_refused_and_can_be_had_again(lmdb_store, monkeypatch):
    monkeypatch.setattr(module, "SNAPSHOTS_MAX_COUNT", 3)
    views = [lmdb_store.snapshot() for _ in range(3)]
    assert code_of(lmdb_store.snapshot) == "STORAGE_BUSY"
    for view in views:
        view.close()
    with lmdb_store.snapshot() as view:
        assert view.state_root == EMPTY_ROOT


async def test_a_closed_snapshot_holds_no_readers_slot_even_while_somebody_still_refers_to_it(lmdb_store):
    """A handler that waits after reading keeps its closed snapshot alive; a thousand of them must not block reading."""
    kept = []
    for _ in range(module.SNAPSHOTS_MAX_COUNT + 100):
        with lmdb_store.snapshot() as snapshot:
            kept.append(snapshot)
    with lmdb_store.snapshot() as snapshot:
        assert snapshot.position == lmdb_store.position


async def test_too_many_waiting_commits_are_refused(lmdb_store, chain, monkeypatch):
    monkeypatch.setattr(module, "COMMITS_WAITING_MAX_COUNT", 0)
    with pytest.raises(BlockRobotError, match=r"^STORAGE_BUSY:"):
        await lmdb_store.commit([chain.block()], b"")


async def test_snapshots_can_be_read_in_other_threads_while_commits_go_on(lmdb_store, chain):
    await lmdb_store.commit([chain.block()], b"")

    def audit() -> bool:
        with lmdb_store.snapshot() as view:
            return compute_root(view.scan(b"", 10_000)) == view.state_root

    audits = []
    for _ in range(20):
        audits.append(asyncio.to_thread(audit))
        await lmdb_store.commit([chain.block()], b"")
    assert all(await asyncio.gather(*audits))


async def test_the_files_are_for_the_owner_alone(tmp_path, chain):
    await filled(tmp_path, chain, 1)
    assert {path.name: path.stat().st_mode & 0o077 for path in tmp_path.iterdir()} == {
        "data.mdb": 0,
        "lock.mdb": 0,
        "owner.lock": 0,
    }
