"""Fetches a snapshot from peers, chunk by chunk, from several at once. Must never keep a byte that does not have its hash.

A manifest counts only if its block is proven final from genesis on; a chunk only if it has the hash that the manifest
names. Whether the manifest told the truth about the state is found by the restore, and then its content is not fetched
again. What was fetched stays on the disk, so that a fetch that was cut off goes on where it was.
"""

from __future__ import annotations

import asyncio
import shutil
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import structlog

from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from node.p2p.wire import RequestKind, SnapshotRequest
from node.snapshot.checking import verify_head
from node.snapshot.form import MANIFEST_NAME, Manifest, SnapshotFolder, chunk_name, compute_content_id, read_manifest
from node.snapshot.shelf import MANIFEST_INDEX

CHUNKS_AT_ONCE_COUNT = 4
OFFER_TRIES_COUNT = 20
OFFER_RETRY_MS = 500

log = structlog.get_logger(__name__)


class Requester(Protocol):
    """Asks peers."""

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Return the answer. Raises PEER_UNAVAILABLE."""
        ...


@dataclass(slots=True)
class _Offer:
    """A snapshot that some peers offer: they may send its chunks."""

    manifest: Manifest
    data: bytes
    peers: list[str]


class SnapshotFetcher:
    """Fetches snapshots into a folder; remembers contents that turned out to be lies."""

    def __init__(self, genesis: Genesis, requester: Requester, folder: Path) -> None:
        self._genesis = genesis
        self._requester = requester
        self._folder = folder
        self._lies: set[bytes] = set()

    def forget(self, source: SnapshotFolder) -> None:
        """A fetched snapshot was refused: never fetch its content again, and drop it."""
        self._lies.add(bytes.fromhex(source.path.name))
        self.drop(source)

    def drop(self, source: SnapshotFolder) -> None:
        """Remove a fetched snapshot."""
        shutil.rmtree(source.path, ignore_errors=True)

    async def fetch(self, peers: Sequence[str], above_height: int) -> SnapshotFolder:
        """Fetch the newest snapshot that peers offer above a height. Raises PEER_UNAVAILABLE if none comes to be."""
        offer = await self._choose(peers, above_height)
        content_id = compute_content_id(offer.manifest)
        place = self._folder / content_id.hex()
        place.mkdir(parents=True, mode=0o700, exist_ok=True)
        log.info(
            "snapshot_fetching", height=offer.manifest.height, chunks=len(offer.manifest.chunks), peers=offer.peers
        )
        waiting = deque(range(len(offer.manifest.chunks)))
        workers = [self._work(offer, content_id, place, waiting) for _ in range(CHUNKS_AT_ONCE_COUNT)]
        await asyncio.gather(*workers)
        (place / MANIFEST_NAME).write_bytes(offer.data)
        return SnapshotFolder(place)

    async def _choose(self, peers: Sequence[str], above_height: int) -> _Offer:
        """Return the best offer: the highest, then the one with most peers. They may still have to make it."""
        for _ in range(OFFER_TRIES_COUNT):
            answers = await asyncio.gather(*(self._ask_offer(peer, above_height) for peer in peers))
            offers: dict[bytes, _Offer] = {}
            for peer, data in zip(peers, answers, strict=True):
                manifest = self._verified(peer, data, above_height)
                if manifest is not None:
                    offer = offers.setdefault(compute_content_id(manifest), _Offer(manifest, data, []))
                    offer.peers.append(peer)
            if offers:
                return max(offers.values(), key=lambda offer: (offer.manifest.height, len(offer.peers), offer.data))
            await asyncio.sleep(OFFER_RETRY_MS / 1000)
        raise BlockRobotError("PEER_UNAVAILABLE", "No peer offers a snapshot.")

    async def _ask_offer(self, peer: str, above_height: int) -> bytes:
        request = SnapshotRequest(content_id=b"", index=MANIFEST_INDEX, above_height=above_height)
        try:
            return await self._requester.request(peer, RequestKind.SNAPSHOT, encode(request))
        except BlockRobotError:
            return b""

    def _verified(self, peer: str, data: bytes, above_height: int) -> Manifest | None:
        if not data:
            return None
        try:
            manifest = read_manifest(data)
            verify_head(manifest, self._genesis)
        except BlockRobotError as error:
            log.warning("snapshot_offer_refused", peer=peer, code=error.code, detail=error.detail)
            return None
        if manifest.height <= above_height or compute_content_id(manifest) in self._lies:
            return None
        return manifest

    async def _work(self, offer: _Offer, content_id: bytes, place: Path, waiting: deque[int]) -> None:
        while waiting:
            index = waiting.popleft()
            path = place / chunk_name(index)
            expected = offer.manifest.chunks[index]
            if path.exists() and sha256(path.read_bytes()) == expected:
                continue
            path.write_bytes(await self._fetch_chunk(offer, content_id, index, expected))

    async def _fetch_chunk(self, offer: _Offer, content_id: bytes, index: int, expected: bytes) -> bytes:
        """Return a chunk from one of the peers, each chunk beginning with another one; who fails is not asked again."""
        request = encode(SnapshotRequest(content_id=content_id, index=index, above_height=0))
        while offer.peers:
            peer = offer.peers[index % len(offer.peers)]
            try:
                data = await self._requester.request(peer, RequestKind.SNAPSHOT, request)
            except BlockRobotError as error:
                log.warning("snapshot_peer_failed", peer=peer, code=error.code)
            else:
                if sha256(data) == expected:
                    return data
                log.warning("snapshot_chunk_refused", peer=peer, index=index)
            if peer in offer.peers:
                offer.peers.remove(peer)
        raise BlockRobotError("PEER_UNAVAILABLE", "No peer sends what is missing of the snapshot.")
