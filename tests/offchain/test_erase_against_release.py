"""The race of erasing and releasing, at every await of both: once the receipt is owed, nothing leaves or comes back."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import pytest

from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipDownload
from consensus.records.sharing import GrantUpload, SharedDownload
from node.custody.blobs.blob_backed_store import BlobBackedStore
from node.custody.finalized_events import FinalizedEvents
from node.custody.stores.custody_store import RecordFacts
from node.custody.stores.mongo_store import MongoStore
from tests.fuzz.target import refusing
from tests.offchain.house import CustodianHarness
from tests.offchain.interleaving import NEVER, Interleaving
from tests.offchain.small_chain import ALICE, CUSTODIAN, RecordedClip, access, erasure, record_clip, recorded
from tests.offchain.test_fetching import Peer, held_by_peer
from tests.offchain.test_sharing import asked, granted, parts_for, request


@dataclass(frozen=True)
class Case:
    """A clip, and what is said of it on the chain."""

    clip: RecordedClip
    part: GrantUpload

    @classmethod
    def at(cls, now_ms: int) -> Case:
        clip = record_clip(FRAMES_COUNT, valid_until_ms=now_ms + 60_000)
        grant_id = sha256(b"grant" + clip.record_id)
        return cls(clip, parts_for(clip, grant_id, valid_until_ms=now_ms + 60_000)[CUSTODIAN])

    def id_of(self, what: str) -> bytes:
        return sha256(what.encode() + self.clip.record_id)


Work = Callable[[CustodianHarness, Case], Coroutine[Any, Any, Any]]
FRAMES_COUNT = 3
STEP_MS = 10
SAMPLED_COUNT = 8
"""How many of all pairs of stops are played in the short tests; a quarter of that on MongoDB."""
SLOW_PAIRS_COUNT = 100
SLOW = (BlobBackedStore, MongoStore)
"""And in the long ones on MongoDB, where all of them take hours."""
COMES_LATE = frozenset(("the same upload", "a peer's copy"))
REFUSALS = (
    "CLIP_ERASED",
    "NOT_FOUND",
    "ACCESS_NOT_GRANTED",
    "GRANT_PARTS_MISSING",
    "GRANT_ENDED",
    "CLIP_NOT_CONFIRMED",
    "NOT_PERMITTED",  # the share has lost the record already
)


async def _repair(house: CustodianHarness, case: Case) -> list[bytes]:
    """Whoever mends read before that the chain keeps the record."""
    clip, told = case.clip, recorded(case.clip)[2]
    roots = told["commitment_root"], told["ciphertext_root"]
    facts = RecordFacts(clip.record_id, clip.upload.txid, ALICE, *roots, told["expires_at_ms"], height=1)
    return await house.custodian.repair_clips([held_by_peer(clip)], lambda _record_ids: {clip.record_id: facts})


RELEASES: dict[str, Work] = {
    "to the owner": lambda house, case: house.custodian.download(case.clip.record_id, case.id_of("own"), ALICE),
    "to the grantee": lambda house, case: house.custodian.download_shared(
        request(case.clip, case.id_of("hers")), case.id_of("grant")
    ),
    "to another custodian": lambda house, case: house.custodian.export(case.clip.record_id),
    "for upkeep": lambda house, case: house.custodian.look_at(case.clip.record_id),
}
ARRIVALS: dict[str, Work] = {
    "the same upload": lambda house, case: house.custodian.stage(case.clip.upload),
    "a peer's copy": lambda house, case: house.custodian.fetch_missing([Peer(held_by_peer(case.clip))]),
    "a part of a key": lambda house, case: house.custodian.stage_part(case.part, ALICE),
    "a copy in place of a damaged one": _repair,
}


async def prepare(house: CustodianHarness, *, is_here: bool, has_part: bool) -> Case:
    """Record a clip that its owner and a grantee asked for; let it be here, and this custodian's part of its key."""
    case, chain = Case.at(house.chain.time_ms), house.chain
    clip, grant_id = case.clip, case.id_of("grant")
    if is_here:
        await house.custodian.stage(clip.upload)
    await house.follow(recorded(clip), at_ms=chain.time_ms + STEP_MS)
    if has_part:
        await house.custodian.stage_part(case.part, ALICE)
    hers = asked(clip, grant_id=grant_id, access_id=case.id_of("hers"))
    said = granted(clip, grant_id=grant_id), access(case.id_of("own"), clip), hers
    await house.follow(*said, at_ms=chain.time_ms + STEP_MS)
    return case


async def is_promised(house: CustodianHarness, case: Case) -> bool:
    """Tell whether this custodian owes the chain its receipt by now."""
    owed = [arguments[0] for call, arguments in await house.ready_outbox() if call == "erasure.receipt"]
    return case.id_of("erasure") in owed


async def require_gone(house: CustodianHarness, case: Case, frames: tuple[int, ...]) -> None:
    """What was erased is neither in the store nor under a key, whatever arrived meanwhile."""
    places = await house.store.frame_places([case.clip.record_id])
    gone = frames or tuple(range(FRAMES_COUNT))
    assert not {place.index for place in places} & set(gone)
    in_use = sorted([slot async for slot in house.store.slots_in_use()])
    assert in_use == house.keys.held, "a key is held to which no row refers, or a row lacks its key"
    assert house.keys.check_destroyed() == 0
    assert await is_promised(house, case)


async def race(playing: Interleaving, case: Case, work: Work, frames: tuple[int, ...], stops: tuple[int, int]) -> None:
    """Play one interleaving of the work and an erasure's block, and judge what came out of both."""
    house = playing.house

    async def working() -> tuple[Any, bool]:
        found = None
        with refusing(*REFUSALS):
            found = await work(house, case)
        return found, await is_promised(house, case)

    block = erasure_of(house, case, frames)
    one, two = await playing.play(working(), stops[0], house.custodian.on_finalized_block(block), stops[1])
    two.result()
    found, was_promised = one.result()
    if was_promised and isinstance(found, ClipDownload | SharedDownload):
        gone = [frame for frame in found.frames if frame.index in (frames or range(FRAMES_COUNT))]
        assert all(frame.erased and not frame.ciphertext for frame in gone), stops
        assert not (isinstance(found, SharedDownload) and found.parts), stops
    await require_gone(house, case, frames)


def erasure_of(house: CustodianHarness, case: Case, frames: tuple[int, ...]) -> FinalizedEvents:
    told = erasure(case.id_of("erasure"), case.clip, frames=frames)
    return house.chain.block(told, at_ms=house.chain.time_ms + STEP_MS)


async def sweep(
    house: CustodianHarness, work: Work, frames: tuple[int, ...], sampled_count: int, **given: bool
) -> None:
    """Play the work against an erasure: the work stopped at each place while all is erased, and pairs of stops."""
    async with house.open():
        playing, case = Interleaving(house), await prepare(house, **given)
        places = await playing.count(work(house, case))
        erasing = await playing.count(house.custodian.on_finalized_block(erasure_of(house, case, frames)))
        assert places >= 2
        assert erasing >= 10
        both = [(stop, other) for stop in range(1, places + 1) for other in range(1, erasing + 1)]
        if sampled_count == NEVER:
            count = SLOW_PAIRS_COUNT if isinstance(house.store, SLOW) else NEVER
        else:
            count = sampled_count // 4 if isinstance(house.store, SLOW) else sampled_count
        step = -(-len(both) // count)
        for stops in [*((stop, NEVER) for stop in range(1, places + 1)), *both[::step]]:
            await race(playing, await prepare(house, **given), work, frames, stops)
            for row in await house.custodian.ready_outbox(100):
                await house.custodian.dismiss(row)


FRAMES = pytest.mark.parametrize("frames", [(), (0, 2)], ids=["record", "frames"])


@FRAMES
@pytest.mark.parametrize("release", RELEASES)
async def test_nothing_leaves_once_a_receipt_is_owed(
    house: CustodianHarness, release: str, frames: tuple[int, ...]
) -> None:
    await sweep(house, RELEASES[release], frames, SAMPLED_COUNT, is_here=True, has_part=True)


@FRAMES
@pytest.mark.parametrize("arrival", ARRIVALS)
async def test_nothing_that_arrives_meanwhile_outlives_the_erasure(
    house: CustodianHarness, arrival: str, frames: tuple[int, ...]
) -> None:
    await sweep(house, ARRIVALS[arrival], frames, SAMPLED_COUNT, is_here=arrival not in COMES_LATE, has_part=False)


@pytest.mark.long
@pytest.mark.timeout(3_600)
@FRAMES
@pytest.mark.parametrize("work", [*RELEASES, *ARRIVALS])
async def test_every_pair_of_places_is_played(house: CustodianHarness, work: str, frames: tuple[int, ...]) -> None:
    given = {"is_here": work not in COMES_LATE, "has_part": work in RELEASES}
    await sweep(house, {**RELEASES, **ARRIVALS}[work], frames, NEVER, **given)


async def test_a_custodian_that_reads_keys_before_its_last_await_would_be_found_out(house: CustodianHarness) -> None:
    async def hasty(house: CustodianHarness, case: Case) -> ClipDownload:
        clip = (await house.store.clips([case.clip.record_id]))[case.clip.record_id]
        found = house.custodian._assemble(clip, await house.store.frames(clip.record_id))
        await house.store.checkpoint()
        return found

    with pytest.raises(AssertionError):
        await sweep(house, hasty, (), SAMPLED_COUNT, is_here=True, has_part=True)
