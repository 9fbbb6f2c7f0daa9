"""Erasing cost by number of kept clips; small clips, since only rows matter."""

from __future__ import annotations

import secrets
import shutil
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from msgspec import Struct

from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import sha256
from consensus.records.commitments import ciphertext_leaves
from network.bench.conditions import percentile
from network.bench.custody.custody_clips import SealedClip, seal_clip
from network.cluster import Cluster
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys, wrap_frames
from node.custody.finalized_events import FinalizedEvent, FinalizedEvents
from node.custody.stores.custody_store import ClipRow, FrameRow
from node.custody.stores.sqlite_rows import write_clip
from node.custody.stores.sqlite_schema import FORMAT_VERSION, SCHEMA
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore

KEPT_FRAMES_COUNT = 2
KEPT_SIZES_BYTES = (64, 80)
"""Of a ciphertext, and of a sealed key."""
ERASED_FRAMES_COUNT, ERASED_FRAME_BYTES = 5, 12_000
WARM_UP_COUNT = 10
_AT_ONCE_COUNT, _CACHE_KIB = 2_000, 512 * 1024
START_MS = 1_800_000_000_000
EXPIRES_MS = START_MS + 30 * 24 * 3_600_000

OnProgress = Callable[[str], None]


def _kept_clips(taken: Sequence[tuple[int, bytes]]) -> Iterator[tuple[ClipRow, list[FrameRow]]]:
    """Whole ones, as their records say, which no wallet can open."""
    for first in range(0, len(taken), KEPT_FRAMES_COUNT):
        record_id, owner = secrets.token_bytes(16), secrets.token_bytes(33)
        texts, keys = ([secrets.token_bytes(size) for _ in range(KEPT_FRAMES_COUNT)] for size in KEPT_SIZES_BYTES)
        leaves = tuple(ciphertext_leaves(texts, keys))
        clip = ClipRow(record_id, bytes(32), 0, "confirmed", leaves, leaves, owner, EXPIRES_MS, 1)
        parts = [(index, text, key) for index, (text, key) in enumerate(zip(texts, keys, strict=True))]
        yield clip, wrap_frames(record_id, parts, taken[first : first + KEPT_FRAMES_COUNT])


def fill(
    folder: Path,
    keys: EraseKeys,
    held: int,
    on_progress: OnProgress,
    note: Callable[[Sequence[ClipRow]], None] = lambda _clips: None,
) -> None:
    """`note` is told of the clips, some thousands at a time."""
    folder.mkdir(mode=0o700, parents=True)
    with closing(sqlite3.connect(folder / DATABASE_FILE_NAME, isolation_level=None)) as database:
        for setting in ("journal_mode = WAL", "synchronous = OFF", "secure_delete = ON", f"cache_size = -{_CACHE_KIB}"):
            database.execute(f"PRAGMA {setting}").fetchall()
        database.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version = {FORMAT_VERSION}; COMMIT;")
        for first in range(0, held, _AT_ONCE_COUNT):
            on_progress(f"filling: {first} of {held} clips")
            taken = keys.allocate(min(_AT_ONCE_COUNT, held - first) * KEPT_FRAMES_COUNT)
            clips = []
            database.execute("BEGIN")
            for clip, frames in _kept_clips(taken):
                write_clip(database, clip, frames)
                clips.append(clip)
            database.execute("COMMIT")
            note(clips)


class HeldBlocks:
    """Blocks for a custodian that has followed those up to a height."""

    def __init__(self, custodian: Custodian, height: int = 0) -> None:
        self._custodian, self._height = custodian, height

    @property
    def now_ms(self) -> int:
        return START_MS + self._height

    async def follow(self, *events: FinalizedEvent) -> tuple[float, float]:
        self._height += 1
        block = FinalizedEvents(self._height, sha256(b"%d" % self._height), self.now_ms, events)
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        await self._custodian.on_finalized_block(block)
        return 1000 * (time.process_time() - cpu_s), 1000 * (time.perf_counter() - wall_s)


def recorded(clip: SealedClip, expires_ms: int = EXPIRES_MS) -> FinalizedEvent:
    owner = clip.upload.owner
    data = {"record_id": clip.record_id, "owner": owner, "robot": owner, "expires_at_ms": expires_ms}
    roots = {"commitment_root": clip.commitment_root, "ciphertext_root": clip.ciphertext_root}
    return FinalizedEvent(clip.upload.txid, "records", "recorded", data | roots)


def erasure_requested(record_ids: Sequence[bytes], owner: bytes) -> FinalizedEvent:
    erasure_id = secrets.token_bytes(32)
    data = {"erasure_id": erasure_id, "owner": owner, "records": list(record_ids), "frames": []}
    return FinalizedEvent(erasure_id, "erasure", "requested", data)


def upload_clip(owner: bytes, frames: int, frame_bytes: int) -> SealedClip:
    return seal_clip(owner, frames, frame_bytes, valid_until_ms=START_MS + TRANSACTION_LIFETIME_MAX_MS)


async def _erasures(custodian: Custodian, count: int) -> AsyncIterator[tuple[float, float]]:
    blocks, owner = HeldBlocks(custodian), secrets.token_bytes(33)
    for _ in range(count):
        clip = upload_clip(owner, ERASED_FRAMES_COUNT, ERASED_FRAME_BYTES)
        await custodian.stage(clip.upload)
        await blocks.follow(recorded(clip))
        yield await blocks.follow(erasure_requested([clip.record_id], owner))


class HeldRow(Struct, frozen=True, kw_only=True):
    """What erasing cost beside so many kept clips: on real nodes until all receipts are final, and a block by itself."""

    held: int
    erase_p50_ms: float
    erase_p95_ms: float
    erase_block_cpu_p50_ms: float
    erase_block_p50_ms: float
    erase_block_p95_ms: float
    bytes_left: int


class HeldClips:
    """A filled store with its keys, which custodians begin with."""

    def __init__(self, folder: Path) -> None:
        self._custody, self._keys = folder / "custody", folder / "erase-keys"

    def fill(self, held: int, on_progress: OnProgress) -> None:
        with EraseKeys(self._keys) as keys:
            fill(self._custody, keys, held, on_progress)

    def give_to_custodians(self, cluster: Cluster) -> None:
        for node in cluster.genesis.custodians:
            config = cluster.config(node.name)
            shutil.copytree(self._custody, config.custody_dir, dirs_exist_ok=True)
            shutil.copytree(self._keys, config.erase_keys_dir, dirs_exist_ok=True)

    async def measure(self, erasures: int, took_ms: Sequence[float]) -> HeldRow:
        """Blocks that erase one five-frame clip each, beside what `took_ms` on nodes."""
        with EraseKeys(self._keys) as keys:
            async with SqliteStore(self._custody) as store:
                custodian = Custodian(store, keys, member=bytes(33), clock_ms=lambda: START_MS)
                took = [each async for each in _erasures(custodian, WARM_UP_COUNT + erasures)][WARM_UP_COUNT:]
                left = await store.leftovers()
                counts = await store.counts()
        cpu_ms, wall_ms = ([pair[place] for pair in took] for place in (0, 1))
        return HeldRow(
            held=counts.confirmed,
            erase_p50_ms=round(percentile(took_ms, 0.50), 1),
            erase_p95_ms=round(percentile(took_ms, 0.95), 1),
            erase_block_cpu_p50_ms=round(percentile(cpu_ms, 0.50), 2),
            erase_block_p50_ms=round(percentile(wall_ms, 0.50), 2),
            erase_block_p95_ms=round(percentile(wall_ms, 0.95), 2),
            bytes_left=(left.log_bytes or 0) + (left.dirty_bytes or 0),
        )
