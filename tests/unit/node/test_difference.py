"""Two nodes that should agree: the first block, key and transaction on which they do not are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lmdb
import msgspec
import pytest

from consensus.chain.block import Block, Receipts
from consensus.primitives.encoding import decode, encode, encode_value
from contracts.state.view import MemoryState
from network.ledger_diff.block_replay import Base
from network.ledger_diff.ledger_difference import LedgerDiff, describe_difference, describe_key
from node.snapshot.making import header_of_block
from node.storage.ledger_store import LedgerSnapshot
from node.storage.lmdb_layout import page_key
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryStore
from tests.unit.node.written_chain import WritingMachine, WrittenChain

KEY = b"records\x00record/" + bytes(range(16))


def report(chain: WrittenChain, first: LedgerSnapshot, second: LedgerSnapshot, *, full: bool = False) -> dict[str, Any]:
    ledgers = (first, second)

    def genesis() -> Base:
        return Base(MemoryState(), 0, chain.genesis.block_id)

    found = LedgerDiff(ledgers, WritingMachine(), genesis, full=full).run()
    told: dict[str, Any] = msgspec.to_builtins(describe_difference(found, ("node-1", "node-2"), ledgers))
    return told


def written(blocks: int = 10) -> WrittenChain:
    """A chain whose block 4 writes KEY, as the second of three transactions."""
    chain = WrittenChain()
    for height in range(1, blocks + 1):
        if height == 4:
            chain.extend({b"a": encode_value(1), KEY: encode_value({"status": "active"})}, transactions=3)
        else:
            chain.extend(transactions=2)
    return chain


async def stores(chain: WrittenChain) -> tuple[MemoryStore, MemoryStore]:
    pair = MemoryStore(), MemoryStore()
    for store in pair:
        await chain.fill(store)
    return pair


def compare(chain: WrittenChain, first: MemoryStore, second: MemoryStore, **options: bool) -> dict[str, Any]:
    with first.snapshot() as one, second.snapshot() as other:
        return report(chain, one, other, **options)


async def test_equal_ledgers_are_the_same_also_if_one_is_behind() -> None:
    chain = written()
    found = compare(chain, *await stores(chain), full=True)
    assert (found["same"], found["kind"]) == (True, "none")
    assert found["heights"] == {"A": 10, "B": 10}
    chain = written(6)
    ahead, behind = MemoryStore(), MemoryStore()
    await chain.fill(behind)
    for _ in range(5):
        chain.extend()
    await chain.fill(ahead)
    for first, second in ((ahead, behind), (behind, ahead)):
        assert compare(chain, first, second)["same"] is True


def damage_value(store: MemoryStore, key: bytes, value: bytes | None) -> None:
    """Change a row of the flat table and leave the trie as it is: what a bad disk or a meddler does."""
    state = store._tables.state
    state.absorb({key: value}, {}, state.state_root)


async def test_a_changed_value_is_named_with_the_transaction_that_wrote_the_true_one() -> None:
    chain = written()
    good, bad = await stores(chain)
    damage_value(bad, KEY, encode_value({"status": "erased"}))
    found = compare(chain, good, bad)
    (key,) = found["keys"]
    assert (found["same"], found["kind"], found["first_block"]) == (False, "state", 4)
    assert (key["contract"], key["key"]) == ("records", "record/" + bytes(range(16)).hex())
    assert key["values"] == {"A": "{'status': 'active'}", "B": "{'status': 'erased'}"}
    assert key["right"] == "A"
    assert key["written_by"]["A"]["txid"] == chain.stored[4].transactions[1][0].hex()
    assert key["written_by"]["A"]["call"] == "records.record"
    assert compare(chain, bad, good)["keys"][0]["right"] == "B"


async def test_the_key_that_was_written_first_comes_first() -> None:
    chain = written()
    good, bad = await stores(chain)
    late = next(key for key in chain.stored[10].state_writes if chain.state.get(key) is not None)
    damage_value(bad, late, None)
    damage_value(bad, KEY, None)
    damage_value(bad, b"records\x00never written", b"x")
    found = compare(chain, good, bad)
    assert [key["flat_key"] for key in found["keys"][1:]] == [KEY.hex(), late.hex()]
    assert found["keys"][0]["written_by"]["A"] is None
    assert [key["right"] for key in found["keys"]] == ["A", "A", "A"]


async def test_a_node_that_is_behind_and_damaged_is_found_out() -> None:
    chain = written(6)
    ahead, behind = MemoryStore(), MemoryStore()
    await chain.fill(behind)
    for _ in range(3):
        chain.extend()
    await chain.fill(ahead)
    damage_value(behind, KEY, None)
    found = compare(chain, ahead, behind)
    assert (found["first_block"], found["keys"][0]["right"]) == (4, "A")


async def test_one_node_that_kept_the_blocks_is_enough_to_name_the_writer_and_none_is_not() -> None:
    chain = written()
    good, bad = await stores(chain)
    for store in (good, bad):
        await store.prune(8, header_of_block)
    damage_value(bad, KEY, None)
    found = compare(chain, good, bad)
    assert found["keys"][0]["right"] == "A"
    assert found["keys"][0]["written_by"] == {"A": None, "B": None}
    assert "No node here holds the body of block 1." in found["notes"][0]
    assert found["bodies_compared_from"] == 8
    chain = written()
    good, bad = await stores(chain)
    await bad.prune(8, header_of_block)
    damage_value(bad, KEY, None)
    assert compare(chain, bad, good)["keys"][0]["written_by"]["B"]["height"] == 4


async def test_a_damaged_body_and_damaged_receipts_are_named() -> None:
    chain = written()
    good, bad = await stores(chain)
    block = decode(chain.stored[5].block_bytes, Block)
    without = encode(msgspec.structs.replace(block, transactions=block.transactions[:1]))
    bad._tables.blocks[5] = msgspec_replace(bad._tables.blocks[5], block_bytes=without)
    found = compare(chain, good, bad)
    assert (found["kind"], found["first_block"], found["right"]) == ("body", 5, "A")
    good, bad = await stores(chain)
    good._tables.blocks[6] = msgspec_replace(good._tables.blocks[6], receipts_bytes=encode(Receipts(())))
    found = compare(chain, good, bad)
    assert (found["kind"], found["first_block"], found["right"]) == ("receipts", 6, "B")


def msgspec_replace(block: Any, **changes: Any) -> Any:
    from dataclasses import replace

    return replace(block, **changes)


async def test_two_finalized_branches_part_at_a_block_and_a_key() -> None:
    """More faulty producers than tolerated: the worst case is told as plainly as the others."""
    chain, other = written(5), written(5)
    chain.extend({b"records\x00x": encode_value(1), b"records\x00y": encode_value(2)}, transactions=2)
    other.extend({b"records\x00x": encode_value(1), b"records\x00y": encode_value(3)}, transactions=2)
    for side in (chain, other):
        for _ in range(3):
            side.extend()
    first, second = MemoryStore(), MemoryStore()
    await chain.fill(first)
    await other.fill(second)
    found = compare(chain, first, second)
    assert (found["kind"], found["first_block"]) == ("header", 6)
    assert found["headers"]["A"]["block_id"] == chain.stored[6].block_id.hex()
    assert found["headers"]["B"]["block_id"] == other.stored[6].block_id.hex()
    (key,) = found["keys"]
    assert (key["key"], key["values"]) == ("y", {"A": "2", "B": "3"})
    assert key["written_by"]["A"]["txid"] == chain.stored[6].transactions[1][0].hex()
    assert key["written_by"]["B"]["txid"] == other.stored[6].transactions[1][0].hex()
    assert found["notes"] == []


async def test_a_fork_below_what_was_pruned_is_still_named_by_its_headers() -> None:
    chain, other = written(5), written(5)
    chain.extend({b"k": encode_value(1)})
    other.extend({b"k": encode_value(2)})
    for side in (chain, other):
        for _ in range(5):
            side.extend()
    first, second = MemoryStore(), MemoryStore()
    await chain.fill(first)
    await other.fill(second)
    await first.prune(9, header_of_block)
    found = compare(chain, first, second)
    assert (found["kind"], found["first_block"], found["keys"]) == ("header", 6, [])
    assert found["notes"] == ["The bodies of the differing blocks were pruned."]


def damage_lmdb(directory: Path, table: bytes, key: bytes, change: Any) -> None:
    environment = lmdb.open(str(directory), max_dbs=20, map_size=1 << 30)
    with environment.begin(write=True) as transaction:
        handle = environment.open_db(table, txn=transaction, create=False)
        transaction.put(key, change(transaction.get(key, db=handle)), db=handle)
    environment.close()


@pytest.fixture
async def on_disk(tmp_path: Path) -> tuple[WrittenChain, Path, Path]:
    chain = written()
    for name in ("a", "b"):
        store = LmdbStore.create(tmp_path / name)
        await chain.fill(store)
        await store.close()
    return chain, tmp_path / "a", tmp_path / "b"


async def test_a_ledger_on_disk_with_a_flipped_byte_in_its_state(on_disk) -> None:
    chain, first, second = on_disk
    damage_lmdb(second, b"state", KEY, lambda value: value[:-1] + bytes([value[-1] ^ 1]))
    with LedgerFile(first) as a, LedgerFile(second) as b, a.snapshot() as one, b.snapshot() as other:
        found = report(chain, one, other)
    assert (found["first_block"], found["keys"][0]["flat_key"], found["keys"][0]["right"]) == (4, KEY.hex(), "A")


async def test_a_damaged_trie_page_is_found_by_the_full_comparison(on_disk) -> None:
    chain, first, second = on_disk
    path = next(path for path in chain.state.pages if path)
    damage_lmdb(second, b"pages", page_key(path), lambda page: page[:-1] + bytes([page[-1] ^ 1]))
    with LedgerFile(first) as a, LedgerFile(second) as b, a.snapshot() as one, b.snapshot() as other:
        assert report(chain, one, other)["same"] is True
        found = report(chain, one, other, full=True)
    assert (found["kind"], found["damaged_pages"][0]) == ("state", f"B:{path.decode()}")


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        (b"records\x00record/\x01\x02", "record/0102"),
        (b"records\x00announcement-count", "announcement-count"),
        (b"producers\x00epoch", "epoch"),
        (b"identity\x00org/hospital", "org/hospital"),
        (b"identity\x00\xff\xfe", "fffe"),
    ],
)
def test_keys_are_readable(key: bytes, shown: str) -> None:
    assert describe_key(key)["key"] == shown
