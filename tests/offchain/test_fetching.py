"""Clips between custodians: one that missed an upload fetches it, and believes nothing but the chain's roots."""

from __future__ import annotations

import asyncio
import os
from dataclasses import replace

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import decode, encode
from consensus.records.clips import ClipDownload, FrameDownload
from node.custody import clip_fetching
from node.custody.clip_fetching import (
    FETCHES_IN_FLIGHT_COUNT,
    INSTALLS_IN_FLIGHT_COUNT,
    PEER_FAILURES_MAX_COUNT,
    check_fetched,
)
from node.custody.stores.custody_store import BlockEffects, RecordFacts
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    RecordedClip,
    access,
    erasure,
    record_clip,
    recorded,
)

AT_ONCE_COUNT = 32


@pytest.fixture(autouse=True)
def few_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clip_fetching, "FETCH_AT_ONCE_COUNT", AT_ONCE_COUNT)


class Peer:
    """Another custodian, for a fetch: sends what it is given."""

    name, member = "other", b""

    def __init__(self, *clips: ClipDownload) -> None:
        self.clips = {clip.record_id: clip for clip in clips}

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        return self.clips.get(record_id)


class DeafPeer:
    name, member = "deaf", b""

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        raise BlockRobotError("NODE_UNREACHABLE")


class SlowPeer:
    name, member = "slow", b""
    asked_count = 0

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        self.asked_count += 1
        await asyncio.sleep(0.05)
        return None


def held_by_peer(clip: RecordedClip, *, erased: tuple[int, ...] = ()) -> ClipDownload:
    frames = [
        FrameDownload(index, True, b"", b"") if index in erased else FrameDownload(index, False, text, key)
        for index, (text, key) in enumerate(zip(clip.upload.ciphertexts, clip.upload.sealed_keys, strict=True))
    ]
    return ClipDownload(clip.record_id, clip.upload.txid, frames, clip.upload.commitment_leaves, clip.leaves)


async def test_a_missed_upload_is_fetched_from_another_custodian(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip), access(ACCESS_ID, clip))
    assert await opened.custodian.fetch_missing([DeafPeer(), Peer(), Peer(held_by_peer(clip))]) == 1
    assert read_all(clip, await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip))]) == 0
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]
    assert read_all(clip, await opened.custodian.export(clip.record_id)) == list(clip.plaintexts)


async def test_clips_that_nobody_has_do_not_keep_older_ones_from_being_fetched(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(*(recorded(record_clip()) for _ in range(AT_ONCE_COUNT + 1)))
    peer = Peer(held_by_peer(clip))
    assert [await opened.custodian.fetch_missing([peer]) for _ in range(2)] == [0, 1]


async def test_a_custodian_that_lets_others_wait_is_asked_last(opened: CustodianHarness) -> None:
    """One that spins out each clip would hold up the repair for hours."""
    clips = [record_clip() for _ in range(5)]
    await opened.follow(*(recorded(clip) for clip in clips))
    slow, good = SlowPeer(), Peer(*(held_by_peer(clip) for clip in clips))
    assert await opened.custodian.fetch_missing([slow, good]) == len(clips)
    assert slow.asked_count == FETCHES_IN_FLIGHT_COUNT


async def test_a_clip_that_nobody_had_is_asked_for_again(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    assert await opened.custodian.fetch_missing([Peer()]) == 0
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip))]) == 1


class NotedPeer(Peer):
    def __init__(self, *clips: ClipDownload) -> None:
        super().__init__(*clips)
        self.asked: list[bytes] = []

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        self.asked.append(record_id)
        return await super().fetch(record_id)


def choose_of_all(missing: list[RecordFacts], asked_for: set[bytes]) -> list[bytes]:
    """The simple version: of everything that is missing the newest that were not asked for, or all again."""
    names = [facts.record_id for facts in missing]
    if not set(names) - asked_for:
        asked_for.clear()
    chosen = [name for name in names if name not in asked_for][:AT_ONCE_COUNT]
    asked_for.update(chosen)
    return chosen


async def test_however_many_newer_ones_nobody_has_each_pass_comes_to_the_oldest(
    opened: CustodianHarness, request: pytest.FixtureRequest
) -> None:
    """It stopped at the newest ten thousand: what a robot records and never uploads kept older clips away for good."""
    vain_count = 640 if "mongo" in request.node.name else 12_000  # 376 questions of as many rows take that server long
    clip = record_clip(1)
    await opened.follow(recorded(clip))
    [facts] = await opened.store.missing(1)
    for height in range(1, vain_count // 20 + 1):
        vain = [replace(facts, record_id=os.urandom(16), height=facts.height + height) for _ in range(20)]
        await opened.store.apply(BlockEffects(missing=tuple(vain)))
    peer, rounds_count = Peer(held_by_peer(clip)), 1 + vain_count // AT_ONCE_COUNT
    assert sum([await opened.custodian.fetch_missing([peer]) for _ in range(rounds_count)]) == 1
    assert opened.custodian.passes_count == 0
    await opened.custodian.fetch_missing([peer])
    assert opened.custodian.passes_count == 1


async def test_what_comes_meanwhile_is_asked_for_before_the_rest_of_a_pass(opened: CustodianHarness) -> None:
    await opened.follow(*(recorded(record_clip(1)) for _ in range(3 * AT_ONCE_COUNT)))
    assert await opened.custodian.fetch_missing([Peer()]) == 0
    clip = record_clip(1)
    await opened.follow(recorded(clip))
    peer = NotedPeer(held_by_peer(clip))
    assert await opened.custodian.fetch_missing([peer]) == 1
    assert (peer.asked[0], len(peer.asked)) == (clip.record_id, AT_ONCE_COUNT)


async def test_each_batch_asks_for_what_the_simple_version_would(opened: CustodianHarness) -> None:
    clips = [record_clip() for _ in range(3 * AT_ONCE_COUNT)]
    for first in range(0, len(clips), 8):
        await opened.follow(*(recorded(clip) for clip in clips[first : first + 8]))
    peer, asked_for = NotedPeer(*(held_by_peer(clip) for clip in clips[::3])), set[bytes]()
    for _ in range(7):
        peer.asked.clear()
        wanted = choose_of_all(await opened.store.missing(10_000), asked_for)
        await opened.custodian.fetch_missing([peer])
        assert peer.asked == wanted


async def test_a_batch_costs_the_same_however_much_is_missing(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [record_clip() for _ in range(3 * AT_ONCE_COUNT)]
    await opened.follow(*(recorded(clip) for clip in clips))
    peer, read_all, limits = Peer(*(held_by_peer(clip) for clip in clips)), opened.store.missing, list[int]()

    async def read_noted(limit: int, after: tuple[int, bytes] | None = None) -> list[RecordFacts]:
        limits.append(limit)
        return await read_all(limit, after)

    monkeypatch.setattr(opened.store, "missing", read_noted)
    fetched = [await opened.custodian.fetch_missing([peer]) for _ in range(4)]
    assert fetched == [AT_ONCE_COUNT] * 3 + [0]
    assert limits == [AT_ONCE_COUNT] * 4


async def test_while_batches_are_stored_as_many_clips_as_ever_are_fetched_and_no_more(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_fetching, "INSTALL_AT_ONCE_MAX_BYTES", 1)
    clips = [record_clip() for _ in range(AT_ONCE_COUNT)]
    await opened.follow(*(recorded(clip) for clip in clips))
    peer, can_store = NotedPeer(*(held_by_peer(clip) for clip in clips)), asyncio.Event()
    install = opened.custodian.install_checked
    storing: list[int] = []

    async def install_held(fetched: list[ClipDownload]) -> int:
        storing.append(len(fetched))
        await can_store.wait()
        return await install(fetched)

    monkeypatch.setattr(opened.custodian, "install_checked", install_held)
    fetching = asyncio.create_task(opened.custodian.fetch_missing([peer]))
    while len(storing) < INSTALLS_IN_FLIGHT_COUNT:
        await opened.store.checkpoint()
    for _ in range(AT_ONCE_COUNT):  # turns of the event loop, in which nothing more begins
        await asyncio.sleep(0)
    assert len(storing) == INSTALLS_IN_FLIGHT_COUNT
    assert len(peer.asked) == FETCHES_IN_FLIGHT_COUNT + INSTALLS_IN_FLIGHT_COUNT
    can_store.set()
    assert await fetching == len(clips)


async def test_a_false_clip_from_a_peer_is_not_installed(opened: CustodianHarness) -> None:
    clip, other = record_clip(), record_clip()
    await opened.follow(recorded(clip))
    good = held_by_peer(clip)
    damaged = msgspec.structs.replace(good.frames[1], ciphertext=good.frames[1].ciphertext[:-1] + b"\x00")
    false = [
        (msgspec.structs.replace(held_by_peer(other), record_id=clip.record_id), "PROOF_INVALID"),
        (msgspec.structs.replace(good, frames=[good.frames[0], damaged, good.frames[2]]), "UPLOAD_HASH_MISMATCH"),
        (msgspec.structs.replace(good, frames=good.frames[:2]), "UPLOAD_INVALID"),
    ]
    for download, code in false:
        with pytest.raises(BlockRobotError, match=code):
            check_fetched(download, (await opened.custodian.missing(1))[0])
        assert await opened.custodian.fetch_missing([Peer(download)]) == 0
    assert opened.keys.held_count == 0
    assert len(await opened.custodian.missing(10)) == 1


async def test_frames_erased_while_a_clip_was_missing_do_not_come_back_with_it(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(erasure(ERASURE_ID, clip, frames=(1,)))
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip))]) == 1
    assert read_all(clip, await opened.custodian.export(clip.record_id))[1] is None
    assert opened.keys.held_count == 2


@pytest.mark.parametrize("erased", [(0,), (0, 1, 2)])
async def test_frames_that_only_a_peer_calls_erased_are_asked_of_another(
    opened: CustodianHarness, erased: tuple[int, ...]
) -> None:
    """It may be ahead of this custodian, or lie."""
    clip = record_clip()
    await opened.follow(recorded(clip))
    ahead = Peer(held_by_peer(clip, erased=erased))
    assert await opened.custodian.fetch_missing([ahead]) == 0
    assert len(await opened.custodian.missing(10)) == 1
    assert await opened.custodian.fetch_missing([ahead, Peer(held_by_peer(clip))]) == 1
    assert read_all(clip, await opened.custodian.export(clip.record_id)) == list(clip.plaintexts)


async def test_frames_that_the_chain_and_the_peer_have_erased_are_installed_as_erased(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(erasure(ERASURE_ID, clip, frames=(0,)))
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip, erased=(0,)))]) == 1
    assert read_all(clip, await opened.custodian.export(clip.record_id)) == [None, *clip.plaintexts[1:]]


async def test_a_peer_that_fails_again_and_again_is_left_alone_until_the_next_round(opened: CustodianHarness) -> None:
    """Or records of a robot that lies, which nobody else has, keep what others have away for hours."""
    clips, asked = [record_clip() for _ in range(AT_ONCE_COUNT)], list[bytes]()
    await opened.follow(*(recorded(clip) for clip in clips))

    class Liar(Peer):
        name = "liar"

        async def fetch(self, record_id: bytes) -> ClipDownload | None:
            asked.append(record_id)
            return held_by_peer(record_clip())

    for _ in range(2):
        asked.clear()
        await opened.custodian.fetch_missing([Liar()])
        assert PEER_FAILURES_MAX_COUNT <= len(asked) < PEER_FAILURES_MAX_COUNT + FETCHES_IN_FLIGHT_COUNT


def test_a_list_longer_than_a_clip_has_frames_is_refused_before_it_is_read() -> None:
    clip = held_by_peer(record_clip())
    too_many = msgspec.structs.replace(clip, frames=clip.frames[:1] * (CLIP_FRAMES_MAX_COUNT + 1))
    with pytest.raises(BlockRobotError, match="ENCODING_INVALID"):
        decode(encode(too_many), ClipDownload)


async def test_a_record_erased_while_its_clip_was_missing_stays_away(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(erasure(ERASURE_ID, clip))
    assert await opened.custodian.missing(10) == []
    assert await opened.custodian.install_checked([held_by_peer(clip)]) == 0
    await refused("CLIP_ERASED", opened.custodian.stage(clip.upload))
    assert [call for call, _ in await opened.ready_outbox()] == ["erasure.receipt"]


async def test_nothing_is_fetched_into_the_disks_reserve_and_erasing_goes_on(opened: CustodianHarness) -> None:
    held, missing = record_clip(), record_clip()
    await opened.keep(held)
    await opened.follow(recorded(missing))
    opened.has_room = False
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(missing))]) == 0
    await opened.follow(erasure(ERASURE_ID, held))
    assert [call for call, _ in await opened.ready_outbox()] == ["erasure.receipt"]
    opened.has_room = True
    fetched = 0
    for _ in range(2):
        fetched += await opened.custodian.fetch_missing([Peer(held_by_peer(missing))])
    assert fetched == 1
