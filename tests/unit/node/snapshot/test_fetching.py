"""A snapshot from peers: some honest, some liars, some that go away."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from node.p2p.wire import RequestKind, SnapshotRequest
from node.snapshot import fetching, joining, making
from node.snapshot.fetching import SnapshotFetcher
from node.snapshot.form import StateChunk, read_manifest, write_manifest
from node.snapshot.joining import Joiner
from node.snapshot.making import header_of_block
from node.snapshot.restoring import adopt_restored
from node.snapshot.shelf import MANIFEST_INDEX, REQUESTED_INTERVAL_MIN_MS, SnapshotShelf
from node.storage.ledger_store import Position
from node.storage.lmdb_reader import LedgerFile
from node.storage.memory_store import MemoryStore
from tests.unit.node.written_chain import WrittenChain

Answer = Callable[[SnapshotRequest, bytes], Awaitable[bytes]]


@pytest.fixture(autouse=True)
def small_and_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "CHUNK_SIZE_BYTES", 600)
    monkeypatch.setattr(fetching, "OFFER_RETRY_MS", 50)
    monkeypatch.setattr(joining, "RETRY_MS", 1)


class Peers:
    """Peers with shelves over the same chain; some answer otherwise than their shelf does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.chain = WrittenChain()
        self.shelves: dict[str, SnapshotShelf] = {}
        self.twisted: dict[str, Answer] = {}
        self.asked: list[tuple[str, int]] = []
        self.stores: dict[str, MemoryStore] = {}

    async def start(self, *names: str, blocks: int = 30) -> None:
        for _ in range(blocks):
            self.chain.extend()
        for name in names:
            store = self.stores[name] = MemoryStore()
            await self.chain.fill(store)
            self.shelves[name] = SnapshotShelf(store, self.folder / name)
            await self.shelves[name].open()

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        assert kind is RequestKind.SNAPSHOT
        request = decode(body, SnapshotRequest)
        self.asked.append((peer, request.index))
        answer = await self.shelves[peer].serve(body)
        return await self.twisted[peer](request, answer) if peer in self.twisted else answer

    async def stop(self) -> None:
        for shelf in self.shelves.values():
            await shelf.stop()


@pytest.fixture
async def peers(tmp_path: Path):
    made = Peers(tmp_path / "peers")
    yield made
    await made.stop()


def joiner_of(peers: Peers, tmp_path: Path, *names: str) -> tuple[Joiner, asyncio.Event]:
    restart = asyncio.Event()

    class Gap:
        position = Position(0, peers.chain.genesis.block_id, bytes(32), 0)

        def snapshot_peers(self, lag_max: int) -> tuple[list[str], int]:
            return list(names), 0

    joiner = Joiner(
        genesis=peers.chain.genesis,
        requester=peers,
        gap=Gap(),
        ledger_dir=tmp_path / "ledger",
        folder=tmp_path / "fetched",
        lag_max=0,
        restart=restart.set,
    )
    return joiner, restart


async def join(joiner: Joiner, restart: asyncio.Event, looks: int = 50) -> None:
    for _ in range(looks):
        joiner.look()
        assert joiner._task is not None
        await joiner._task
        if restart.is_set():
            return


async def test_chunks_come_from_several_peers_and_make_a_ledger(peers: Peers, tmp_path: Path) -> None:
    await peers.start("b", "c", "d")
    for name, shelf in peers.shelves.items():
        shelf.begin(peers.stores[name].snapshot())
        await shelf.stop()
    joiner, restart = joiner_of(peers, tmp_path, "b", "c", "d")
    await join(joiner, restart)
    assert restart.is_set()
    assert {peer for peer, index in peers.asked if index != MANIFEST_INDEX} == {"b", "c", "d"}
    adopt_restored(tmp_path / "ledger")
    with LedgerFile(tmp_path / "ledger") as ledger, ledger.snapshot() as view:
        assert view.position == peers.chain.stored[-1].position
    assert list((tmp_path / "fetched").iterdir()) == []


async def test_a_peer_that_sends_other_bytes_is_asked_no_more(peers: Peers, tmp_path: Path) -> None:
    await peers.start("b", "liar")

    async def lie(request: SnapshotRequest, answer: bytes) -> bytes:
        return answer if request.index == MANIFEST_INDEX else answer[:-1] + bytes([answer[-1] ^ 1])

    peers.twisted["liar"] = lie
    joiner, restart = joiner_of(peers, tmp_path, "b", "liar")
    await join(joiner, restart)
    assert restart.is_set()
    assert sum(peer == "liar" and index != MANIFEST_INDEX for peer, index in peers.asked) <= 4


async def test_a_peer_whose_whole_snapshot_lies_is_found_out_by_the_state_and_another_is_taken(
    peers: Peers, tmp_path: Path
) -> None:
    """Its manifest is proven final and all its chunks fit it: only the state's root tells."""
    await peers.start("b", "liar")
    forged: dict[int, bytes] = {}

    async def lie(request: SnapshotRequest, answer: bytes) -> bytes:
        if request.index != MANIFEST_INDEX:
            return forged.get(request.index, answer)
        if not answer:
            return b""
        manifest = read_manifest(answer)
        last = len(manifest.chunks) - 1
        true = await peers.shelves["liar"].serve(
            encode(SnapshotRequest(fetching.compute_content_id(manifest), last, 0))
        )
        rows = decode(true, StateChunk).rows
        forged[last] = encode(StateChunk((*rows[:-1], (rows[-1][0], b"mine" * 5))))
        return write_manifest(msgspec.structs.replace(manifest, chunks=(*manifest.chunks[:-1], sha256(forged[last]))))

    async def serve_forged(request: SnapshotRequest, answer: bytes) -> bytes:
        if request.index == MANIFEST_INDEX or answer:
            return await lie(request, answer)
        honest = read_manifest(await peers.shelves["liar"].serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0))))
        content = fetching.compute_content_id(honest)
        return await lie(
            request,
            await peers.shelves["liar"].serve(encode(SnapshotRequest(content, request.index, 0))),
        )

    peers.twisted["liar"] = serve_forged
    alone, restart = joiner_of(peers, tmp_path, "liar")
    await join(alone, restart, looks=1)
    assert not restart.is_set()
    assert not (tmp_path / "ledger.incoming").exists()
    assert list((tmp_path / "fetched").iterdir()) == []
    alone._gap.snapshot_peers = lambda _lag: (["liar", "b"], 0)  # type: ignore[method-assign]
    await join(alone, restart)
    assert restart.is_set()


async def test_an_offer_that_genesis_does_not_prove_is_not_taken(peers: Peers, tmp_path: Path) -> None:
    await peers.start("liar")

    async def lie(request: SnapshotRequest, answer: bytes) -> bytes:
        if request.index == MANIFEST_INDEX and answer:
            return write_manifest(msgspec.structs.replace(read_manifest(answer), finality=b""))
        return answer

    peers.twisted["liar"] = lie
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError) as refused:
        await fetcher.fetch(["liar"], 0)
    assert refused.value.code == "PEER_UNAVAILABLE"
    assert {index for _, index in peers.asked} == {MANIFEST_INDEX}


async def test_a_fetch_that_was_cut_off_goes_on_where_it_was(peers: Peers, tmp_path: Path) -> None:
    await peers.start("b")
    left = 5

    async def go_away(request: SnapshotRequest, answer: bytes) -> bytes:
        nonlocal left
        left -= request.index != MANIFEST_INDEX
        if left < 0:
            raise BlockRobotError("PEER_UNAVAILABLE")
        return answer

    peers.twisted["b"] = go_away
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError):
        await fetcher.fetch(["b"], 0)
    del peers.twisted["b"]
    peers.asked.clear()
    source = await fetcher.fetch(["b"], 0)
    total = len(read_manifest(source.manifest()).chunks)
    assert total > 8
    assert sum(index != MANIFEST_INDEX for _, index in peers.asked) <= total - 5


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
    again = SnapshotShelf(store, peers.folder / "b")
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


# What a liar can cost


async def make_shelves(peers: Peers) -> None:
    for name, shelf in peers.shelves.items():
        shelf.begin(peers.stores[name].snapshot())
        await shelf.stop()


def lying_about(peers: Peers, **changes: object) -> Answer:
    """A peer that changes its manifest, and sends the true chunks for it."""

    async def lie(request: SnapshotRequest, answer: bytes) -> bytes:
        if request.index == MANIFEST_INDEX:
            return write_manifest(msgspec.structs.replace(read_manifest(answer), **changes)) if answer else b""
        shelf = peers.shelves["a-liar"]
        own = read_manifest(await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0))))
        return await shelf.serve(encode(SnapshotRequest(fetching.compute_content_id(own), request.index, 0)))

    return lie


@pytest.mark.parametrize("difference_bytes", [-700, -1, 1])
async def test_a_size_that_is_a_lie_is_held_against_the_liar_alone(
    peers: Peers, tmp_path: Path, difference_bytes: int
) -> None:
    await peers.start("a-liar", "b")
    await make_shelves(peers)
    true = next(iter(peers.shelves["b"]._known.values()))[1]
    peers.twisted["a-liar"] = lying_about(peers, size_bytes=true.size_bytes + difference_bytes)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError) as refused:
        await fetcher.fetch(["a-liar"], 0)
    assert refused.value.code == "SNAPSHOT_DAMAGED"
    assert list((tmp_path / "fetched").iterdir()) == []
    peers.asked.clear()
    source = await fetcher.fetch(["a-liar", "b"], 0)
    assert read_manifest(source.manifest()) == true
    assert {peer for peer, index in peers.asked if index != MANIFEST_INDEX} == {"b"}


async def test_a_fetch_stops_once_the_chunks_are_more_than_was_offered(peers: Peers, tmp_path: Path) -> None:
    await peers.start("a-liar")
    await make_shelves(peers)
    peers.twisted["a-liar"] = lying_about(peers, size_bytes=1_000)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError):
        await fetcher.fetch(["a-liar"], 0)
    assert sum(index != MANIFEST_INDEX for _, index in peers.asked) <= 2 * fetching.CHUNKS_AT_ONCE_COUNT


async def test_a_chunk_larger_than_any_is_refused_whatever_its_hash(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("a-liar")
    await make_shelves(peers)
    monkeypatch.setattr(fetching, "CHUNK_SIZE_MAX_BYTES", 300)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError) as refused:
        await fetcher.fetch(["a-liar"], 0)
    assert refused.value.code == "SNAPSHOT_DAMAGED"
    assert list((tmp_path / "fetched").iterdir()) == []


async def test_a_snapshot_that_the_disk_has_no_room_for_is_not_begun(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("a-liar", "b")
    await make_shelves(peers)
    true = next(iter(peers.shelves["b"]._known.values()))[1]
    monkeypatch.setattr(fetching, "free_space_bytes", lambda _folder: fetching.space_needed_bytes(true))
    peers.twisted["a-liar"] = lying_about(peers, size_bytes=true.size_bytes + 1)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError) as refused:
        await fetcher.fetch(["a-liar"], 0)
    assert refused.value.code == "STORAGE_FULL"
    assert {index for _, index in peers.asked} == {MANIFEST_INDEX}
    source = await fetcher.fetch(["a-liar", "b"], 0)
    assert read_manifest(source.manifest()) == true


async def test_what_a_full_disk_cut_off_does_not_stay_on_it(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("b")
    await make_shelves(peers)
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "chunk-000003":
            raise OSError(28, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(OSError, match="No space"):
        await fetcher.fetch(["b"], 0)
    assert list((tmp_path / "fetched").iterdir()) == []


async def test_a_new_fetch_clears_away_what_others_left_half_done(peers: Peers, tmp_path: Path) -> None:
    await peers.start("b")
    await make_shelves(peers)
    (tmp_path / "fetched" / bytes(32).hex()).mkdir(parents=True)
    (tmp_path / "fetched" / bytes(32).hex() / "chunk-000000").write_bytes(b"half")
    source = await SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched").fetch(["b"], 0)
    assert list((tmp_path / "fetched").iterdir()) == [source.path]


async def test_what_more_peers_offer_is_preferred_to_what_is_newer(peers: Peers, tmp_path: Path) -> None:
    """A snapshot that several hold is made of more people's words, and comes from several disks at once."""
    await peers.start("b", "c", "d", blocks=10)
    for name in ("b", "c"):
        peers.shelves[name].begin(peers.stores[name].snapshot())
        await peers.shelves[name].stop()
    for _ in range(5):
        peers.chain.extend()
    await peers.chain.fill(peers.stores["d"])
    peers.shelves["d"].begin(peers.stores["d"].snapshot())
    await peers.shelves["d"].stop()
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    assert read_manifest((await fetcher.fetch(["b", "c", "d"], 0)).manifest()).height == 10
    assert read_manifest((await fetcher.fetch(["b", "c", "d"], 10)).manifest()).height == 15


async def test_a_peer_whose_offer_comes_to_nothing_stands_behind_the_others(peers: Peers, tmp_path: Path) -> None:
    await peers.start("b", "z-liar")
    await make_shelves(peers)

    async def lie(request: SnapshotRequest, answer: bytes) -> bytes:
        if request.index != MANIFEST_INDEX:
            return b""
        manifest = read_manifest(answer)
        return write_manifest(msgspec.structs.replace(manifest, chunks=(*manifest.chunks[:-1], b"\xff" * 32)))

    peers.twisted["z-liar"] = lie
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError):
        await fetcher.fetch(["z-liar"], 0)
    for _ in range(3):
        source = await fetcher.fetch(["z-liar", "b"], 0)
        assert read_manifest(source.manifest()).chunks[-1] != b"\xff" * 32


async def test_a_manifest_is_verified_once_and_not_on_the_event_loop(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("b", "c", "d")
    await make_shelves(peers)
    threads: list[int] = []
    verify = fetching.verify_head

    def watched(*arguments: Any) -> Any:
        threads.append(threading.get_ident())
        return verify(*arguments)

    monkeypatch.setattr(fetching, "verify_head", watched)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    for _ in range(3):
        await fetcher.fetch(["b", "c", "d"], 0)
    assert len(threads) == 1
    assert threads[0] != threading.get_ident()


async def test_peers_cannot_keep_a_node_busy_making_snapshots(peers: Peers) -> None:
    """Each asks for one above the block before the newest, again and again, while the chain goes on."""
    await peers.start("b", blocks=10)
    now_ms = 0
    store = peers.stores["b"]
    shelf = SnapshotShelf(store, peers.folder / "limited", now_ms=lambda: now_ms)
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

    shelf = SnapshotShelf(store, peers.folder / "limited", now_ms=slow)
    await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0)))
    await shelf.stop()
    peers.chain.extend()
    await peers.chain.fill(store)
    await shelf.serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 10)))
    await shelf.stop()
    assert list(shelf._known) == [10]


async def test_a_node_that_got_there_by_blocks_does_not_begin_anew(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("b")
    await make_shelves(peers)
    joiner, restart = joiner_of(peers, tmp_path, "b")
    positions = iter([joiner._gap.position, peers.chain.stored[-1].position])
    monkeypatch.setattr(type(joiner._gap), "position", property(lambda _gap: next(positions)))
    await join(joiner, restart, looks=1)
    assert not restart.is_set()
    assert not (tmp_path / "ledger.incoming").exists()
    assert list((tmp_path / "fetched").iterdir()) == []


async def test_a_disk_that_fails_while_the_ledger_is_built_is_not_held_against_the_peer(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await peers.start("b")
    await make_shelves(peers)
    build, refusals = joining.build_aside, [BlockRobotError("STORAGE_FULL"), OSError(5, "Input/output error")]

    def failing(*arguments: Any, **options: Any) -> Any:
        if refusals:
            raise refusals.pop()
        return build(*arguments, **options)

    monkeypatch.setattr(joining, "build_aside", failing)
    joiner, restart = joiner_of(peers, tmp_path, "b")
    await join(joiner, restart, looks=3)
    assert restart.is_set()


async def test_stopping_waits_for_the_ledger_that_is_being_built(
    peers: Peers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it would be written to while the next start clears it away."""
    await peers.start("b")
    await make_shelves(peers)
    begun, go_on, ended = threading.Event(), threading.Event(), threading.Event()
    build = joining.build_aside

    def slow(source: Any, genesis: Any, ledger_dir: Path, progress: Any, **options: Any) -> Any:
        begun.set()
        go_on.wait(10)
        try:
            return build(source, genesis, ledger_dir, progress, **options)
        finally:
            ended.set()

    monkeypatch.setattr(joining, "build_aside", slow)
    joiner, restart = joiner_of(peers, tmp_path, "b")
    joiner.look()
    await asyncio.to_thread(begun.wait, 10)
    stopping = asyncio.create_task(joiner.stop())
    await asyncio.sleep(0)
    go_on.set()
    await stopping
    assert ended.is_set()
    assert not restart.is_set()
    assert not (tmp_path / "ledger.incoming").exists()
