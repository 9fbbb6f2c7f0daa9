"""A snapshot from peers: some honest, some liars, some that go away."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from node.p2p.wire import SnapshotRequest
from node.snapshot import fetching, joining
from node.snapshot.fetching import SnapshotFetcher
from node.snapshot.restoring import adopt_restored
from node.snapshot.snapshot_format import StateChunk, read_manifest, write_manifest
from node.snapshot.snapshot_store import MANIFEST_INDEX
from node.storage.lmdb_reader import LedgerFile
from tests.unit.node.snapshot.snapshot_peers import Peers, join, joiner_of, make_shelves


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
        return await lie(request, await peers.shelves["liar"].serve(encode(SnapshotRequest(content, request.index, 0))))

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
    with pytest.raises(BlockRobotError, match=r"^PEER_UNAVAILABLE:"):
        await fetcher.fetch(["liar"], 0)
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
    joiner.start_if_behind()
    await asyncio.to_thread(begun.wait, 10)
    stopping = asyncio.create_task(joiner.stop())
    await asyncio.sleep(0)
    go_on.set()
    await stopping
    assert ended.is_set()
    assert not restart.is_set()
    assert not (tmp_path / "ledger.incoming").exists()
