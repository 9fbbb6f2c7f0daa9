"""What a liar among the peers can cost a node that fetches a snapshot: little."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import msgspec
import pytest

from consensus.errors import BlockRobotError
from node.p2p.wire import SnapshotRequest
from node.snapshot import fetching
from node.snapshot.fetching import SnapshotFetcher
from node.snapshot.snapshot_format import read_manifest, write_manifest
from node.snapshot.snapshot_store import MANIFEST_INDEX
from tests.unit.node.snapshot.snapshot_peers import Peers, lying_about, make_shelves


@pytest.mark.parametrize("difference_bytes", [-700, -1, 1])
async def test_a_size_that_is_a_lie_is_held_against_the_liar_alone(
    peers: Peers, tmp_path: Path, difference_bytes: int
) -> None:
    await peers.start("a-liar", "b")
    await make_shelves(peers)
    true = next(iter(peers.shelves["b"]._known.values()))[1]
    peers.twisted["a-liar"] = lying_about(peers, size_bytes=true.size_bytes + difference_bytes)
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_DAMAGED:"):
        await fetcher.fetch(["a-liar"], 0)
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
    with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_DAMAGED:"):
        await fetcher.fetch(["a-liar"], 0)
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
    with pytest.raises(BlockRobotError, match=r"^STORAGE_FULL:"):
        await fetcher.fetch(["a-liar"], 0)
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
