"""Custody costs: erasing on real nodes, following, catching up, scanning, storage."""

from __future__ import annotations

import asyncio
import math
import secrets
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import msgspec
from msgspec import Struct
from pymongo import MongoClient

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload
from consensus.records.owner_keys import open_visit_keys, scan_announcement
from network.bench.clips_apart import ClipsApart, removed_after
from network.bench.conditions import Result, measure_conditions, percentile
from network.bench.custody.custody_clips import ClipRobot, SealedClip, seal_clip
from network.bench.custody.custody_held import HeldClips, HeldRow
from network.bench.fresh_network import FreshNetwork
from network.cluster import READY_TIMEOUT_S, Cluster
from node.custody.coordination.custody_coordinator import BLOCKS_AT_ONCE_COUNT
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.finalized_events import FinalizedEvent, FinalizedEvents
from node.custody.stores.custody_store import CustodyStore
from node.custody.stores.open_store import MONGO_SCHEMES, open_store

NODES_COUNT = 4
BLOCK_RECORDS_COUNT = 50
EXPIRES_AFTER_MS = 30 * 24 * 3_600_000
SCANNED_COUNT = 2_000
SLOWER_MAX_TIMES = 3.0
"""How many times as long the other store may take for any of what is compared."""
HOSPITAL_DAY_VISITS_COUNT = 20_000
"""What is taken for a day of a large hospital: five thousand people, whom robots meet four times each."""
HELD_START_MAX_S = 600.0
"""Of nodes whose custodians hold a million clips: each slot and each page of the store is read."""
_START_MS = 1_800_000_000_000

OnProgress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class CustodyOptions:
    """Store, erasures, backlog and clip size; with `held` only erasing beside kept clips is measured; `beside`: the store
    that is measured after it in the same run; `apart`: where clips are kept, with `beside` those of that store alone.
    """

    store: str = "sqlite"
    erasures: int = 50
    behind: int = 10_000
    frames: int = 5
    frame_bytes: int = 12_000
    held: tuple[int, ...] = ()
    beside: str = ""
    apart: ClipsApart | None = None


class _Custody:
    def __init__(self, store: CustodyStore, keys: EraseKeys, uri: str) -> None:
        self.store, self.keys, self.uri = store, keys, uri
        self.custodian = Custodian(store, keys, member=secrets.token_bytes(33), clock_ms=lambda: _START_MS)

    name, member = "other", b""

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        return await self.custodian.export(record_id)


@asynccontextmanager
async def _open_custody(uri: str, folder: Path, apart: ClipsApart | None) -> AsyncIterator[_Custody]:
    name = f"blockrobot-bench-{secrets.token_hex(4)}"
    own = urlunsplit(urlsplit(uri)._replace(path=f"/{name}")) if uri.startswith(MONGO_SCHEMES) else uri
    try:
        place = None if apart is None else apart.place_of(folder.name, folder)
        async with open_store(own, folder / "custody", clips=place) as store:
            with EraseKeys(folder / "erase-keys") as keys:
                yield _Custody(store, keys, own)
    finally:
        if own != uri:
            with MongoClient[Any](own) as client:
                client.drop_database(name)


def _block(height: int, clips: Sequence[SealedClip]) -> FinalizedEvents:
    events = []
    for clip in clips:
        owner = clip.upload.owner
        data = {"record_id": clip.record_id, "owner": owner, "robot": owner}
        roots = {"commitment_root": clip.commitment_root, "ciphertext_root": clip.ciphertext_root}
        expiry = {"expires_at_ms": _START_MS + EXPIRES_AFTER_MS}
        events.append(FinalizedEvent(sha256(clip.record_id), "records", "recorded", {**data, **roots, **expiry}))
    return FinalizedEvents(height, sha256(b"%d" % height), _START_MS + height, tuple(events))


def _make_clip(options: CustodyOptions, owner: bytes) -> SealedClip:
    valid_until_ms = _START_MS + TRANSACTION_LIFETIME_MAX_MS
    return seal_clip(owner, options.frames, options.frame_bytes, valid_until_ms=valid_until_ms)


class FollowingFigures(Struct, frozen=True, kw_only=True):
    """What following the chain costs a custodian.

    `hook_records_per_s`: staged clips confirmed in blocks of fifty; `catchup_s`: following and fetching `behind` clips;
    `store_overhead`: disk bytes, erase keys included, clips that are kept apart not, per ciphertext byte, null where the
    store does not tell.
    """

    hook_records_per_s: float
    catchup_s: float
    store_overhead: float | None
    ciphertext_bytes: int
    clips_lost: int


class CustodyFigures(FollowingFigures, frozen=True, kw_only=True):
    """What custody costs.

    `erase_p50_ms`/`erase_p95_ms`: request to all receipts final; `scan_records_per_s` per core; `hospital_day_scan_s`:
    a day without proofs and network.
    """

    erase_p50_ms: float
    erase_p95_ms: float
    scan_records_per_s: float
    hospital_day_scan_s: float
    errors: int
    error_codes: dict[str, int]


class HeldFigures(Struct, frozen=True, kw_only=True):
    """What erasing costs by the number of kept clips; `erase_ratio`: the largest `erase_p50_ms` by the least."""

    held: list[HeldRow]
    erase_ratio: float
    cpu_ratio: float
    errors: int


class ComparedFigures(Struct, frozen=True, kw_only=True):
    """The same work with two stores, one after the other.

    `times_slower`: how many times as long `beside` takes, by figure; null where nothing was measured; `goal` at most.
    `machine_times_slower`: the same of scanning, which uses no store: far from 1, other work made the difference.
    """

    store: CustodyFigures
    beside: CustodyFigures
    times_slower: dict[str, float | None]
    machine_times_slower: float
    missed: list[str]
    goal: float


def compare_stores(store: CustodyFigures, beside: CustodyFigures) -> ComparedFigures:
    slower: dict[str, float | None] = {}
    for name in ("erase_p50_ms", "erase_p95_ms", "hook_records_per_s", "catchup_s"):
        took, beside_took = getattr(store, name), getattr(beside, name)
        if name == "hook_records_per_s":
            took, beside_took = beside_took, took
        slower[name] = round(beside_took / took, 2) if took and beside_took else None
    missed = [name for name, times in slower.items() if times is None or times > SLOWER_MAX_TIMES]
    return ComparedFigures(
        store=store,
        beside=beside,
        times_slower=slower,
        machine_times_slower=round(store.scan_records_per_s / beside.scan_records_per_s, 2),
        missed=missed,
        goal=SLOWER_MAX_TIMES,
    )


async def _measure_following(options: CustodyOptions, folder: Path, on_progress: OnProgress) -> FollowingFigures:
    async with (
        _open_custody(options.store, folder / "a", options.apart) as awake,
        _open_custody(options.store, folder / "b", options.apart) as away,
    ):
        size_bytes, hook_s = 0, 0.0
        blocks: list[FinalizedEvents] = []
        for first in range(0, options.behind, BLOCK_RECORDS_COUNT):
            on_progress(f"following: {first} of {options.behind} records")
            owner = secrets.token_bytes(33)
            clips = [_make_clip(options, owner) for _ in range(min(BLOCK_RECORDS_COUNT, options.behind - first))]
            for clip in clips:
                await awake.custodian.stage(clip.upload)
            size_bytes += sum(clip.size_bytes for clip in clips)
            block = _block(len(blocks) + 1, clips)
            blocks.append(block)
            started_s = time.perf_counter()
            await awake.custodian.on_finalized_block(block)
            hook_s += time.perf_counter() - started_s
        caught_up_s = await _measure_catching_up(blocks, awake, away, options.behind, on_progress)
        held = [(await custody.store.counts()).confirmed for custody in (awake, away)]
        stored_bytes = await _stored_bytes(folder / "a", awake)
    return FollowingFigures(
        hook_records_per_s=round(options.behind / hook_s, 1),
        catchup_s=round(caught_up_s, 2),
        store_overhead=None if stored_bytes is None else round(stored_bytes / size_bytes, 3),
        ciphertext_bytes=size_bytes,
        clips_lost=2 * options.behind - sum(held),
    )


async def _measure_catching_up(
    blocks: Sequence[FinalizedEvents], awake: _Custody, away: _Custody, behind: int, on_progress: OnProgress
) -> float:
    started_s = time.perf_counter()
    for first in range(0, len(blocks), BLOCKS_AT_ONCE_COUNT):
        await away.custodian.on_finalized_blocks(blocks[first : first + BLOCKS_AT_ONCE_COUNT])
    fetched = 0
    while count := await away.custodian.fetch_missing([awake]):
        fetched += count
        on_progress(f"catching up: {fetched} of {behind} clips fetched")
    return time.perf_counter() - started_s


async def _stored_bytes(folder: Path, custody: _Custody) -> int | None:
    await custody.store.sweep()
    keys = sum(path.stat().st_size for path in (folder / "erase-keys").iterdir())
    size_bytes = (await custody.store.counts()).size_bytes
    if size_bytes is None and custody.uri.startswith(MONGO_SCHEMES):
        with MongoClient[Any](custody.uri) as client:
            statistics = client.get_default_database().command("dbStats")
        size_bytes = int(statistics["storageSize"]) + int(statistics["indexSize"])
    return None if size_bytes is None else size_bytes + keys


def _measure_scanning() -> float:
    """Announcements a second on one core, none the wallet's."""
    view, spend = (PrivateKey(secrets.token_bytes(32)) for _ in range(2))
    stranger = PrivateKey(secrets.token_bytes(32)).public_key
    chain_id, robot = secrets.token_bytes(32), PrivateKey(secrets.token_bytes(32)).public_key
    visits = [
        open_visit_keys(secrets.token_bytes(32), stranger, stranger, chain_id=chain_id, robot=robot)
        for _ in range(SCANNED_COUNT)
    ]
    started_s = time.perf_counter()
    for visit in visits:
        scan_announcement(view, spend.public_key, visit.ephemeral, visit.view_tag, chain_id=chain_id, robot=robot)
    return SCANNED_COUNT / (time.perf_counter() - started_s)


async def _measure_erasing(
    options: CustodyOptions,
    on_progress: OnProgress,
    prepare: Callable[[Cluster], None] = lambda _cluster: None,
    start_max_s: float = READY_TIMEOUT_S,
) -> tuple[list[float], dict[str, int]]:
    took_ms: list[float] = []
    errors: dict[str, int] = {}
    async with FreshNetwork(
        NODES_COUNT, store=options.store, apart=options.apart, prepare=prepare, start_max_s=start_max_s
    ) as network:
        (enrolled,) = await network.enrol_robots(1)
        robot = ClipRobot(enrolled.key, network.open_client())
        owner = await robot.open_visit()
        for number in range(options.erasures):
            on_progress(f"erasing: {number} of {options.erasures}")
            try:
                clip = await robot.record(owner, options.frames, options.frame_bytes)
                started_s = time.perf_counter()
                await robot.wait_erased(owner, await robot.request_erasure(owner, [clip.record_id]))
                took_ms.append(1000 * (time.perf_counter() - started_s))
            except BlockRobotError as error:
                errors[error.code] = errors.get(error.code, 0) + 1
    return took_ms, errors


async def _run_held(options: CustodyOptions, on_progress: OnProgress) -> Result[HeldFigures]:
    conditions = measure_conditions(
        nodes=NODES_COUNT, store="sqlite", erasures=options.erasures, held=list(options.held)
    )
    folder = Path(tempfile.mkdtemp(prefix="blockrobot-bench-custody-"))
    rows, errors_count = [], 0
    async with removed_after(folder, None):
        for held in options.held:
            clips = HeldClips(folder / str(held))
            await asyncio.to_thread(clips.fill, held, on_progress)
            took_ms, errors = await _measure_erasing(options, on_progress, clips.give_to_custodians, HELD_START_MAX_S)
            errors_count += sum(errors.values())
            on_progress(f"erasing among {held} clips")
            rows.append(await clips.measure(options.erasures, took_ms))
    costs, waits = [row.erase_block_cpu_p50_ms for row in rows], [row.erase_p50_ms for row in rows]
    figures = HeldFigures(
        held=rows,
        erase_ratio=round(max(waits) / (min(waits) or math.inf), 2),
        cpu_ratio=round(max(costs) / min(costs), 2),
        errors=errors_count,
    )
    ok = not (errors_count or any(row.bytes_left for row in rows))
    return Result(name="custody", ok=ok, figures=figures, conditions=conditions)


async def _run_beside(options: CustodyOptions, on_progress: OnProgress) -> Result[ComparedFigures]:
    first = await _run_one(replace(options, apart=None), on_progress)
    second = await _run_one(replace(options, store=options.beside), on_progress)
    figures = compare_stores(first.figures, second.figures)
    beside = {f"beside_{name}": second.conditions[name] for name in ("store", "clips", "load")}
    ok = first.ok and second.ok and not figures.missed
    return Result(name="custody", ok=ok, figures=figures, conditions={**first.conditions, **beside})


async def run_custody_benchmark(
    options: CustodyOptions, on_progress: OnProgress = lambda _text: None
) -> Result[CustodyFigures] | Result[HeldFigures] | Result[ComparedFigures]:
    """`ok` is False after any error or missing clip, or if the store `beside` is too slow."""
    if options.held:
        return await _run_held(options, on_progress)
    return await (_run_beside if options.beside else _run_one)(options, on_progress)


async def _run_one(options: CustodyOptions, on_progress: OnProgress) -> Result[CustodyFigures]:
    conditions = measure_conditions(
        nodes=NODES_COUNT,
        store="mongodb" if options.store.startswith(MONGO_SCHEMES) else options.store,
        clips=options.apart.kind if options.apart else "store",
        erasures=options.erasures,
        behind=options.behind,
        frames_a_clip=options.frames,
        frame_bytes=options.frame_bytes,
        hospital_day_visits=HOSPITAL_DAY_VISITS_COUNT,
    )
    folder = Path(tempfile.mkdtemp(prefix="blockrobot-bench-custody-"))
    async with removed_after(folder, options.apart):
        took_ms, errors = await _measure_erasing(options, on_progress)
        following = await _measure_following(options, folder, on_progress)
    on_progress("scanning")
    scanned_per_s = await asyncio.to_thread(_measure_scanning)
    figures = CustodyFigures(
        **msgspec.structs.asdict(following),
        erase_p50_ms=round(percentile(took_ms, 0.50), 1),
        erase_p95_ms=round(percentile(took_ms, 0.95), 1),
        scan_records_per_s=round(scanned_per_s, 1),
        hospital_day_scan_s=round(HOSPITAL_DAY_VISITS_COUNT / scanned_per_s, 2),
        errors=sum(errors.values()),
        error_codes=dict(sorted(errors.items())),
    )
    ok = not errors and bool(took_ms) and figures.clips_lost == 0
    return Result(name="custody", ok=ok, figures=figures, conditions=conditions)
