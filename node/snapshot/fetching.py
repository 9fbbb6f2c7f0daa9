"""Fetches a snapshot's chunks from several peers, resumable.

Accepted: manifests with a proven block, chunks with their hash.
"""

from __future__ import annotations

import asyncio
import secrets
import shutil
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import structlog

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from node.p2p.wire import RequestKind, SnapshotRequest
from node.snapshot.checking import verify_head
from node.snapshot.snapshot_format import (
    CHUNK_SIZE_MAX_BYTES,
    MANIFEST_NAME,
    Manifest,
    SnapshotFolder,
    chunk_name,
    compute_content_id,
    read_manifest,
)
from node.snapshot.snapshot_store import MANIFEST_INDEX

CHUNKS_AT_ONCE_COUNT = 4
OFFER_TRIES_COUNT = 20
OFFER_RETRY_MS = 500
OFFER_RATE_MIN_BYTES_PER_S = 256 * 1024
"""Less than chunks of honest sizes have that each come just before their request is given up."""
OFFER_PATIENCE_MS = 30_000
"""How long an offer may stay below that rate. So a snapshot takes at most this and its size at that rate."""
VERDICTS_MAX_COUNT = 16
SPACE_KEPT_FREE_BYTES = 64 * 1024 * 1024
SPACE_PER_SNAPSHOT_COUNT = 4
"""A snapshot takes at most this many times its size on the disk: its chunks, and the ledger that is built of them."""

log = structlog.get_logger(__name__)


class Requester(Protocol):
    """Asks peers."""

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        ...


T = TypeVar("T")


async def _aside(work: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(None, work)


def space_needed_bytes(manifest: Manifest) -> int:
    return SPACE_PER_SNAPSHOT_COUNT * manifest.size_bytes + SPACE_KEPT_FREE_BYTES


def free_space_bytes(folder: Path) -> int:
    """Return free bytes where a folder is or will be. Raises OSError."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


@dataclass(slots=True)
class _Offer:
    """A snapshot that some peers offer; the manifest is that of `origin`."""

    origin: str
    manifest: Manifest
    content_id: bytes
    data: bytes
    peers: list[str]
    fetched_bytes: int = 0
    deadline: asyncio.Timeout = field(default_factory=lambda: asyncio.timeout(None))

    def allow(self, size_bytes: int) -> None:
        """Allow the next chunks the time that these bytes may take, and never more than the patience."""
        latest_s = asyncio.get_running_loop().time() + OFFER_PATIENCE_MS / 1000
        until_s = self.deadline.when()
        bought_s = latest_s if until_s is None else until_s + size_bytes / OFFER_RATE_MIN_BYTES_PER_S
        self.deadline.reschedule(min(bought_s, latest_s))

    def take(self, size_bytes: int) -> None:
        """Raises SNAPSHOT_DAMAGED."""
        self.fetched_bytes += size_bytes
        if size_bytes > CHUNK_SIZE_MAX_BYTES or self.fetched_bytes > self.manifest.size_bytes:
            raise BlockRobotError("SNAPSHOT_DAMAGED", "The chunks have more bytes than the manifest says.")
        self.allow(size_bytes)


class SnapshotFetcher:
    """Fetches snapshots into a folder; remembers peers with wrong manifests or chunks."""

    def __init__(self, genesis: Genesis, requester: Requester, folder: Path) -> None:
        self._genesis = genesis
        self._requester = requester
        self._folder = folder
        self._liars: set[str] = set()
        self._failures: Counter[str] = Counter()
        self._salt = secrets.token_bytes(HASH_SIZE_BYTES)
        self._origins: dict[Path, str] = {}
        self._verdicts: dict[bytes, tuple[Manifest, bytes] | BlockRobotError] = {}

    def forget(self, source: SnapshotFolder) -> None:
        """Drop a rejected snapshot and distrust its manifest's peer."""
        self._blame(self._origins[source.path])
        self.drop(source)

    def _blame(self, peer: str) -> None:
        log.warning("snapshot_peer_lied", peer=peer)
        self._liars.add(peer)

    def drop(self, source: SnapshotFolder) -> None:
        shutil.rmtree(source.path, ignore_errors=True)

    async def fetch(self, peers: Sequence[str], above_height: int) -> SnapshotFolder:
        """Fetch the snapshot above a height that most peers offer.

        Raises PEER_UNAVAILABLE, STORAGE_FULL, SNAPSHOT_DAMAGED, OSError; the last two leave nothing.
        """
        offer = await self._choose(peers, above_height)
        behind_it = tuple(offer.peers)
        place = self._folder / offer.content_id.hex()
        self._origins = {place: offer.origin}
        log.info(
            "snapshot_fetching", height=offer.manifest.height, chunks=len(offer.manifest.chunks), peers=offer.peers
        )
        try:
            await _aside(partial(self._prepare, place))
            await self._fetch_chunks(offer, place)
            await _aside(partial((place / MANIFEST_NAME).write_bytes, offer.data))
        except BlockRobotError as error:
            self._failures.update(behind_it)
            if error.code == "SNAPSHOT_DAMAGED":
                self._blame(offer.origin)
                await _aside(partial(shutil.rmtree, place, ignore_errors=True))
            raise
        except OSError:
            await _aside(partial(shutil.rmtree, place, ignore_errors=True))
            raise
        return SnapshotFolder(place)

    def _prepare(self, place: Path) -> None:
        place.mkdir(parents=True, mode=0o700, exist_ok=True)
        for other in self._folder.iterdir():
            if other != place:
                shutil.rmtree(other, ignore_errors=True)

    async def _fetch_chunks(self, offer: _Offer, place: Path) -> None:
        waiting = deque(range(len(offer.manifest.chunks)))
        try:
            async with offer.deadline:
                offer.allow(0)
                workers = [self._work(offer, place, waiting) for _ in range(CHUNKS_AT_ONCE_COUNT)]
                failures = await asyncio.gather(*workers, return_exceptions=True)
        except TimeoutError:
            log.warning("snapshot_offer_slow", peers=offer.peers, fetched_bytes=offer.fetched_bytes)
            raise BlockRobotError("PEER_UNAVAILABLE", "The snapshot comes too slowly.") from None
        for failure in failures:
            if failure is not None:
                raise failure
        if offer.fetched_bytes != offer.manifest.size_bytes:
            raise BlockRobotError("SNAPSHOT_DAMAGED", "The chunks have fewer bytes than the manifest says.")

    async def _choose(self, peers: Sequence[str], above_height: int) -> _Offer:
        asked = [peer for peer in peers if peer not in self._liars]
        for _ in range(OFFER_TRIES_COUNT):
            answers = await asyncio.gather(*(self._ask_offer(peer, above_height) for peer in asked))
            offers: dict[bytes, _Offer] = {}
            for peer, data in sorted(zip(asked, answers, strict=True), key=lambda item: self._failures[item[0]]):
                found = await self._verified(peer, data) if data else None
                if found is None:
                    asked = [other for other in asked if other != peer or not data]
                elif found[0].height > above_height:
                    manifest, content_id = found
                    offers.setdefault(content_id, _Offer(peer, manifest, content_id, data, [])).peers.append(peer)
            if offers:
                return max(await self._fitting(list(offers.values())), key=self._rank)
            await asyncio.sleep(OFFER_RETRY_MS / 1000)
        raise BlockRobotError("PEER_UNAVAILABLE", "No peer offers a snapshot.")

    def _rank(self, offer: _Offer) -> tuple[int, int, int, int, bytes]:
        """What costs little if it is a lie goes before what is newest; a tie is won by luck, not by a ground hash."""
        costliness = offer.manifest.size_bytes.bit_length() // 2
        luck = sha256(self._salt + offer.content_id)
        return -self._failures[offer.origin], len(offer.peers), -costliness, offer.manifest.height, luck

    async def _fitting(self, offers: list[_Offer]) -> list[_Offer]:
        """Raises STORAGE_FULL."""
        free_bytes = await _aside(partial(free_space_bytes, self._folder))
        fitting = [offer for offer in offers if space_needed_bytes(offer.manifest) <= free_bytes]
        if not fitting:
            needed_bytes = min(space_needed_bytes(offer.manifest) for offer in offers)
            raise BlockRobotError(
                "STORAGE_FULL", f"The disk has {free_bytes} bytes; the snapshot needs {needed_bytes}."
            )
        return fitting

    async def _ask_offer(self, peer: str, above_height: int) -> bytes:
        request = SnapshotRequest(content_id=b"", index=MANIFEST_INDEX, above_height=above_height)
        try:
            return await self._requester.request(peer, RequestKind.SNAPSHOT, encode(request))
        except BlockRobotError:
            return b""

    async def _verified(self, peer: str, data: bytes) -> tuple[Manifest, bytes] | None:
        verdict = await _aside(partial(self._verdict, data))
        if isinstance(verdict, BlockRobotError):
            log.warning("snapshot_offer_refused", peer=peer, code=verdict.code, detail=verdict.detail)
            return None
        return verdict

    def _verdict(self, data: bytes) -> tuple[Manifest, bytes] | BlockRobotError:
        digest = sha256(data)
        if digest not in self._verdicts:
            try:
                manifest = read_manifest(data)
                verify_head(manifest, self._genesis)
                self._verdicts[digest] = (manifest, compute_content_id(manifest))
            except BlockRobotError as error:
                self._verdicts[digest] = error.with_traceback(None)
            if len(self._verdicts) > VERDICTS_MAX_COUNT:
                del self._verdicts[next(iter(self._verdicts))]
        return self._verdicts[digest]

    async def _work(self, offer: _Offer, place: Path, waiting: deque[int]) -> None:
        try:
            while waiting:
                await self._take_chunk(offer, place, waiting.popleft())
        finally:
            waiting.clear()

    async def _take_chunk(self, offer: _Offer, place: Path, index: int) -> None:
        data = await _aside(partial(_read_kept, place, index, offer.manifest.chunks[index]))
        if data is not None:
            offer.take(len(data))
            return
        data = await self._fetch_chunk(offer, index)
        offer.take(len(data))
        await _aside(partial((place / chunk_name(index)).write_bytes, data))

    async def _fetch_chunk(self, offer: _Offer, index: int) -> bytes:
        request = encode(SnapshotRequest(content_id=offer.content_id, index=index, above_height=0))
        expected = offer.manifest.chunks[index]
        while offer.peers:
            fewest = min(self._failures[peer] for peer in offer.peers)
            best = [peer for peer in offer.peers if self._failures[peer] == fewest]
            peer = best[index % len(best)]
            try:
                data = await self._requester.request(peer, RequestKind.SNAPSHOT, request)
            except BlockRobotError as error:
                log.warning("snapshot_peer_failed", peer=peer, code=error.code)
            else:
                if sha256(data) == expected:
                    return data
                log.warning("snapshot_chunk_refused", peer=peer, index=index)
                if data:
                    self._blame(peer)
            if peer in offer.peers:
                offer.peers.remove(peer)
        raise BlockRobotError("PEER_UNAVAILABLE", "No peer sends what is missing of the snapshot.")


def _read_kept(place: Path, index: int, expected: bytes) -> bytes | None:
    try:
        data = SnapshotFolder(place).chunk(index)
    except BlockRobotError:
        return None
    return data if sha256(data) == expected else None
