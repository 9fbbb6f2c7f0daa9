"""Peers that offer snapshots of one chain, and a node that joins by one."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec

from consensus.primitives.encoding import decode, encode
from node.p2p.wire import RequestKind, SnapshotRequest
from node.snapshot import fetching
from node.snapshot.joining import SnapshotJoiner
from node.snapshot.snapshot_format import read_manifest, write_manifest
from node.snapshot.snapshot_store import MANIFEST_INDEX, SnapshotStore
from node.storage.ledger_store import Position
from node.storage.memory_store import MemoryStore
from tests.unit.node.written_chain import WrittenChain

Answer = Callable[[SnapshotRequest, bytes], Awaitable[bytes]]


class Peers:
    """Peers with shelves over the same chain; some answer otherwise than their shelf does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.chain = WrittenChain()
        self.shelves: dict[str, SnapshotStore] = {}
        self.twisted: dict[str, Answer] = {}
        self.asked: list[tuple[str, int]] = []
        self.stores: dict[str, MemoryStore] = {}

    async def start(self, *names: str, blocks: int = 30) -> None:
        for _ in range(blocks):
            self.chain.extend()
        for name in names:
            store = self.stores[name] = MemoryStore()
            await self.chain.fill(store)
            self.shelves[name] = SnapshotStore(store, self.folder / name)
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


def joiner_of(peers: Peers, tmp_path: Path, *names: str) -> tuple[SnapshotJoiner, asyncio.Event]:
    restart = asyncio.Event()

    class SyncGap:
        position = Position(0, peers.chain.genesis.block_id, bytes(32), 0)

        def snapshot_peers(self, lag_max: int) -> tuple[list[str], int]:
            return list(names), 0

    joiner = SnapshotJoiner(
        genesis=peers.chain.genesis,
        requester=peers,
        gap=SyncGap(),
        ledger_dir=tmp_path / "ledger",
        folder=tmp_path / "fetched",
        lag_max=0,
        restart=restart.set,
    )
    return joiner, restart


async def join(joiner: SnapshotJoiner, restart: asyncio.Event, looks: int = 50) -> None:
    for _ in range(looks):
        joiner.start_if_behind()
        assert joiner._task is not None
        await joiner._task
        if restart.is_set():
            return


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
