"""What a custodian's work costs beside the clips it holds."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from consensus.limits import SEALED_METADATA_BYTES
from consensus.primitives.encoding import encode, encode_value
from consensus.records.clips import ClipDownload, FrameDownload
from consensus.records.commitments import ciphertext_leaves, ciphertext_root, commitment_root
from consensus.state.keys import to_value
from consensus.state.records import RECORD, RecordRow
from consensus.state.settings import UploadQuotas
from network.bench.custody.custody_clips import SealedClip
from network.bench.custody.custody_held import (
    ERASED_FRAME_BYTES,
    ERASED_FRAMES_COUNT,
    HeldBlocks,
    OnProgress,
    erasure_requested,
    fill,
    recorded,
    upload_clip,
)
from network.bench.growth.growth_on_ledger import Measured
from network.bench.growth.growth_timing import Spent, Tell, time_operation, time_scan
from node.custody.chain_facts import ChainFacts
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.repair.scrub import RecordComparer, ScrubReport, scrub
from node.custody.stores.custody_store import Checkpoint, ClipRow
from node.custody.stores.sqlite_store import SqliteStore
from node.custody.uploads.upload_usage import UploadTerms
from node.storage import lmdb_layout as layout
from node.storage.ledger_store import Position
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_store import MAP_SIZE_START_BYTES, open_environment

CAUGHT_UP_CLIPS_COUNT = 16
_KEYS, _CUSTODY, _STATE = "erase-keys", "custody", "state"


def fill_custody(folder: Path, held: int, on_progress: OnProgress) -> None:
    """A store with so many clips, and the state of the chain (without trie) that has their records."""
    state = folder / _STATE
    state.mkdir(parents=True)
    environment = open_environment(state, MAP_SIZE_START_BYTES, sync=False)
    tables = layout.Tables.open(environment, None, create=True)

    def note(clips: Sequence[ClipRow]) -> None:
        with environment.begin(write=True) as transaction:
            for clip in clips:
                transaction.put(RECORD.key(clip.record_id), _record_of(clip), db=tables.state)

    with EraseKeys(folder / _KEYS) as keys:
        fill(folder / _CUSTODY, keys, held, on_progress, note)
    with environment.begin(write=True) as transaction:
        position = Position(1, bytes(32), bytes(32), 1)
        transaction.put(layout.META_POSITION, encode(position), db=tables.meta)
        transaction.put(layout.META_FORMAT, layout.FORMAT_NAME, db=tables.meta)
    environment.sync(True)
    environment.close()


def _record_of(clip: ClipRow) -> bytes:
    row = RecordRow(
        owner=clip.owner,
        robot=clip.owner,
        commitment_root=commitment_root(clip.commitment_leaves),
        ciphertext_root=ciphertext_root(clip.ciphertext_leaves),
        sealed_metadata=bytes(SEALED_METADATA_BYTES),
        bucket_ms=0,
        expires_at_ms=clip.expires_at_ms,
        height=clip.height,
        txid=clip.txid,
        status="active",
        erased_frames=[],
        awaited=[],
    )
    return encode_value(to_value(row))


class _Other:
    """A custodian with the clips that this one missed."""

    name = "other"
    member = bytes(33)

    def __init__(self, clips: Sequence[SealedClip]) -> None:
        self._clips = {clip.record_id: clip for clip in clips}

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        upload = self._clips[record_id].upload
        pairs = enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True))
        return ClipDownload(
            record_id=record_id,
            txid=upload.txid,
            frames=[FrameDownload(index=i, erased=False, ciphertext=text, sealed_key=key) for i, (text, key) in pairs],
            commitment_leaves=upload.commitment_leaves,
            ciphertext_leaves=ciphertext_leaves(upload.ciphertexts, upload.sealed_keys),
        )


class CustodyGrowth:
    """One custodian beside its held clips; what is measured leaves as many, and a mark for each erased one."""

    def __init__(self, store: SqliteStore, keys: EraseKeys, ledger: LedgerFile, point: Checkpoint | None) -> None:
        self._store, self._keys, self._ledger = store, keys, ledger
        self.custodian = Custodian(store, keys, member=bytes(33), clock_ms=lambda: self._blocks.now_ms)
        self._blocks = HeldBlocks(self.custodian, 0 if point is None else point.height)
        self._owner = secrets.token_bytes(33)
        self._terms = UploadTerms(self._owner, UploadQuotas(), lambda _robot: "hospital", lambda _robot: b"")

    async def _stage(self, count: int = 1) -> list[SealedClip]:
        clips = [upload_clip(self._owner, ERASED_FRAMES_COUNT, ERASED_FRAME_BYTES) for _ in range(count)]
        for clip in clips:
            await self.custodian.stage(clip.upload)
        return clips

    async def _erase(self, clips: Sequence[SealedClip]) -> None:
        await self._blocks.follow(erasure_requested([clip.record_id for clip in clips], self._owner))

    async def upload(self, spent: Spent) -> None:
        clip = upload_clip(self._owner, ERASED_FRAMES_COUNT, ERASED_FRAME_BYTES)
        with spent.once():
            await self.custodian.stage(clip.upload, self._terms)
        await self._blocks.follow(recorded(clip))
        await self._erase([clip])

    async def erase(self, spent: Spent) -> None:
        clips = await self._stage()
        await self._blocks.follow(recorded(clips[0]))
        with spent.once():
            await self._erase(clips)

    async def sweep_expired(self, spent: Spent) -> None:
        clips = await self._stage()
        await self._blocks.follow(recorded(clips[0], self._blocks.now_ms + 2))
        with spent.once():
            await self._blocks.follow()
        if (await self._store.clips([clips[0].record_id]))[clips[0].record_id].status != "erased":
            raise RuntimeError("the clip of the benchmark did not expire")

    async def follow_idle(self, spent: Spent) -> None:
        with spent.once():
            await self._blocks.follow()

    async def catch_up(self, spent: Spent) -> None:
        clips = [
            upload_clip(self._owner, ERASED_FRAMES_COUNT, ERASED_FRAME_BYTES) for _ in range(CAUGHT_UP_CLIPS_COUNT)
        ]
        other = _Other(clips)
        with spent.once():
            await self._blocks.follow(*(recorded(clip) for clip in clips))
            fetched = await self.custodian.fetch_missing([other])
        if fetched != len(clips):
            raise RuntimeError("the custodian of the benchmark did not catch up")
        await self._erase(clips)

    @contextmanager
    def _facts(self, point: Checkpoint) -> Iterator[ChainFacts]:
        with self._ledger.snapshot() as snapshot:
            yield ChainFacts(snapshot, point)

    async def _point(self) -> Checkpoint:
        point = await self.custodian.checkpoint()
        assert point is not None, "blocks were followed before"
        return point

    async def scrub_one(self, record_ids: Sequence[bytes], spent: Spent) -> None:
        record_id = secrets.choice(record_ids)
        with self._facts(await self._point()) as facts, spent.once():
            comparer, report = RecordComparer(self.custodian, self._store, facts), ScrubReport()
            clip = (await self._store.clips([record_id]))[record_id]
            is_well = await comparer.compare(record_id, facts.record(record_id), clip, report)
        if not is_well:
            raise RuntimeError("a clip of the benchmark is not as its record says")

    async def download(self, record_ids: Sequence[bytes], spent: Spent) -> None:
        with spent.once():
            await self.custodian.export(secrets.choice(record_ids))

    async def scrub_all(self, tell: Tell) -> None:
        point = await self._point()
        report = await scrub(self.custodian, self._store, self._keys, lambda: self._facts(point), lambda *_: tell())
        if not report.is_clean:
            raise RuntimeError(f"the custodian of the benchmark is not clean: {report.leftovers}")

    async def start(self, tell: Tell) -> None:
        await self.custodian.start(lambda _slots: tell())

    async def count(self, _tell: Tell) -> None:
        await self._store.counts()

    async def sample(self) -> list[bytes]:
        """Ids from all over the store."""
        with self._ledger.snapshot() as snapshot:
            starts = (RECORD.start(bytes((first,))) for first in range(0, 256, 4))
            found = [next(snapshot.scan_range(start, RECORD.start(b"\xff" * 16)), None) for start in starts]
        return [RECORD.split(row[0])[0] for row in found if row is not None]


async def measure_custody(folder: Path, size: int) -> Measured:
    with EraseKeys(folder / _KEYS) as keys, LedgerFile(folder / _STATE) as ledger:
        async with SqliteStore(folder / _CUSTODY) as store:
            bench = CustodyGrowth(store, keys, ledger, await store.checkpoint())
            await bench.follow_idle(Spent())
            named = await bench.sample()
            yield "custodian: an empty block", await time_operation(size, bench.follow_idle)
            yield "custodian: upload of a clip", await time_operation(size, bench.upload)
            yield "custodian: erasure of a clip", await time_operation(size, bench.erase)
            yield "custodian: expiry sweep", await time_operation(size, bench.sweep_expired)
            yield "custodian: catching up with 16 clips", await time_operation(size, bench.catch_up)
            yield "custodian: scrub of a clip", await time_operation(size, partial(bench.scrub_one, named))
            yield "custodian: download of a clip", await time_operation(size, partial(bench.download, named))
            yield "custodian start: keys reconciled", await time_scan(size, bench.start)
            yield "custody status: counts", await time_scan(size, bench.count)
            yield "scrub of all clips", await time_scan(size, bench.scrub_all)
