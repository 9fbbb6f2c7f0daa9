"""The shelf on which a node keeps a snapshot for its peers."""

from __future__ import annotations

from consensus.primitives.encoding import encode
from node.p2p.wire import SnapshotRequest
from node.snapshot.making import header_of_block
from node.snapshot.snapshot_format import read_manifest
from node.snapshot.snapshot_store import MANIFEST_INDEX, REQUESTED_INTERVAL_MIN_MS, SnapshotStore
from tests.unit.node.snapshot.snapshot_peers import Peers


async def test_a_shelf_makes_what_is_asked_for_and_keeps_the_newest(peers: Peers) -> None:
    await peers.start("b", blocks=10)
    shelf, store = peers.shelves["b"], peers.stores["b"]

    async def offered(above: int) -> int | None:
        data = await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, above)))
        return read_manifest(data).height if data else None

    assert await offered(0) is None
    await shelf.stop()
    assert await offered(0) == 10
    assert await offered(10) is None
    for _ in range(3):
        for _ in range(5):
            peers.chain.extend()
        await peers.chain.fill(store)
        shelf.begin(store.snapshot())
        await shelf.stop()
    assert await offered(0) == 25
    assert sorted(path.name for path in (peers.folder / "b").iterdir()) == ["000000000020", "000000000025"]
    again = SnapshotStore(store, peers.folder / "b")
    (peers.folder / "b" / "half").mkdir()
    await again.open()
    assert sorted(again._known) == [20, 25]
    assert not (peers.folder / "b" / "half").exists()
    assert await again.serve(encode(SnapshotRequest(bytes(32), 0, 0))) == b""


async def test_a_snapshot_whose_next_block_was_pruned_is_made_anew(peers: Peers) -> None:
    await peers.start("b", blocks=10)
    shelf, store = peers.shelves["b"], peers.stores["b"]
    shelf.begin(store.snapshot())
    await shelf.stop()
    for _ in range(20):
        peers.chain.extend()
    await peers.chain.fill(store)
    await store.prune(20, header_of_block)
    assert await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0))) == b""
    await shelf.stop()
    data = await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0)))
    assert read_manifest(data).height == 30


async def test_after_pruning_there_is_a_snapshot_from_which_blocks_lead_on_and_no_older_one(peers: Peers) -> None:
    """What was erased since would stand in an old one still."""
    await peers.start("b", blocks=10)
    shelf, store = peers.shelves["b"], peers.stores["b"]
    shelf.begin(store.snapshot())
    await shelf.stop()
    for _ in range(20):
        peers.chain.extend()
    await peers.chain.fill(store)
    shelf.note_pruned(await store.prune(11, header_of_block))
    await shelf.stop()
    assert sorted(shelf._known) == [10]
    shelf.note_pruned(await store.prune(12, header_of_block))
    await shelf.stop()
    assert sorted(shelf._known) == [30]
    assert [path.name for path in (peers.folder / "b").iterdir()] == ["000000000030"]


async def test_peers_cannot_keep_a_node_busy_making_snapshots(peers: Peers) -> None:
    """Each asks for one above the block before the newest, again and again, while the chain goes on."""
    await peers.start("b", blocks=10)
    now_ms = 0
    store = peers.stores["b"]
    shelf = SnapshotStore(store, peers.folder / "limited", now_ms=lambda: now_ms)
    made: list[int] = []
    for _ in range(20):
        peers.chain.extend()
        await peers.chain.fill(store)
        above = store.position.height - 1  # type: ignore[union-attr]
        await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, above)))
        await shelf.stop()
        made += [height for height in shelf._known if height not in made]
        now_ms += REQUESTED_INTERVAL_MIN_MS // 10
    assert made == [11, 21]


async def test_the_longer_a_snapshot_takes_the_longer_the_next_one_has_to_wait(peers: Peers) -> None:
    await peers.start("b", blocks=10)
    now_ms = 0
    store = peers.stores["b"]

    def slow() -> int:
        nonlocal now_ms
        now_ms += REQUESTED_INTERVAL_MIN_MS
        return now_ms

    shelf = SnapshotStore(store, peers.folder / "limited", now_ms=slow)
    await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0)))
    await shelf.stop()
    peers.chain.extend()
    await peers.chain.fill(store)
    await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 10)))
    await shelf.stop()
    assert list(shelf._known) == [10]
