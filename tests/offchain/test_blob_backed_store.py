"""Ciphertexts outside the custodian's store: whose they are, what is lost, swapped or left over, what names tell."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload
from node.clips_place import read_place
from node.custody.blobs import blob_backed_store
from node.custody.blobs.blob_backed_store import BlobBackedStore
from node.custody.blobs.blob_names import BlobNames, new_generation
from node.custody.blobs.blob_store import OWNER_NAME
from node.custody.blobs.place_file import PLACE_FILE_NAME
from node.custody.chain_facts import ChainFacts
from node.custody.many_at_once import AT_ONCE_COUNT, for_each
from node.custody.repair import rebuild
from node.custody.stores.custody_store import CustodyStore
from node.custody.stores.open_store import open_store
from node.custody.stores.share_store import ShareStore
from node.custody.uploads.upload_usage import UploadAccount
from tests.offchain.desk import CustodyHarness, Peer
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import ALICE, EXPIRES_MS, RecordedClip, access, erasure, record_clip, recorded
from tests.offchain.test_fetching import DeafPeer

KEY = b"k" * 32


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[CustodianHarness]:
    place = read_place("folder:blobs", tmp_path)
    house = CustodianHarness(lambda: open_store("sqlite", tmp_path / "custody", clips=place), tmp_path / "erase-keys")
    async with house.open():
        yield house


async def path_of(house: CustodianHarness, clip: RecordedClip, tmp_path: Path) -> Path:
    store: Any = house.store
    (name,) = [name async for name in store._blobs.names(store._names.prefix(clip.record_id))]
    return tmp_path / "blobs" / name


async def test_the_index_holds_no_ciphertext_and_the_folder_nothing_else(
    house: CustodianHarness, tmp_path: Path
) -> None:
    clip = await house.keep()
    index = b"".join(path.read_bytes() for path in (tmp_path / "custody").glob("custody.sqlite3*"))
    assert not any(text in index for text in clip.upload.ciphertexts)
    assert (await path_of(house, clip, tmp_path)).read_bytes() == b"".join(clip.upload.ciphertexts)
    names = [path.name for path in (tmp_path / "blobs").rglob("*") if path.is_file()]
    assert len(names) == 2
    assert not any(clip.record_id.hex() in name for name in names)


@pytest.mark.parametrize("how", ["lost", "cut short", "garbage", "another clip's", "an older generation"])
async def test_what_happened_to_a_blob_is_found_by_the_scrub_and_mended_from_another_custodian(
    house: CustodianHarness, tmp_path: Path, how: str
) -> None:
    desk, clip, other = CustodyHarness(house), record_clip(), record_clip()
    await desk.hold(clip, other)
    path = await path_of(house, clip, tmp_path)
    if how == "lost":
        path.unlink()
    elif how == "cut short":
        path.write_bytes(path.read_bytes()[:-1])
    elif how == "garbage":
        path.write_bytes(bytes(path.stat().st_size))
    elif how == "another clip's":
        path.write_bytes((await path_of(house, other, tmp_path)).read_bytes())
    else:
        old = path.read_bytes()
        store: Any = house.store
        await store.replace_frames(clip.record_id, [*reversed(await store.frames(clip.record_id))])
        (await path_of(house, clip, tmp_path)).write_bytes(old)
    report = await desk.scrub()
    assert {record_id for record_id, _ in report.corrupted} == {clip.record_id}
    rebuilt = await desk.rebuild(Peer(clip))
    assert rebuilt.is_whole
    assert await desk.opens(clip)
    assert (await desk.scrub()).is_clean


class ErasingPeer(Peer):
    """Another custodian, asked for a clip of which a picture is erased meanwhile."""

    def __init__(self, desk: CustodyHarness, *clips: RecordedClip) -> None:
        super().__init__(*clips)
        self.desk, self.asked = desk, list[bytes]()

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        self.asked.append(record_id)
        assert not self.desk.house.custodian._writing.locked()
        if len(self.asked) == len(self.clips):
            clip = self.clips[record_id]
            await self.desk.house.follow(erasure(ERASURE_ID, clip, frames=(0,)))
            self.desk.state.erasure(clip, frames=(0,))
        return await super().fetch(record_id)


async def test_a_place_that_lost_all_clips_is_filled_some_at_a_time_and_what_is_erased_meanwhile_stays_so(
    house: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk, clips, rests = CustodyHarness(house), [record_clip() for _ in range(5)], list[int]()
    await desk.hold(*clips)
    for clip in clips:
        (await path_of(house, clip, tmp_path)).unlink()
    monkeypatch.setattr(rebuild, "RECORDS_AT_ONCE_COUNT", 2)
    caught_up, scanned, erased_frames = rebuild.caught_up, list[int](), ChainFacts.erased_frames

    def counted(*given: Any) -> Any:
        rests.append(1)
        return caught_up(*given)

    def noted(facts: ChainFacts) -> dict[bytes, frozenset[int]]:
        scanned.append(facts.point.height)
        return erased_frames(facts)

    monkeypatch.setattr(rebuild, "caught_up", counted)
    monkeypatch.setattr(ChainFacts, "erased_frames", noted)
    peer = ErasingPeer(desk, *clips)
    report = await desk.rebuild(DeafPeer(), peer)
    assert (report.mended, report.is_whole) == (sorted(clip.record_id for clip in clips), True)
    assert sorted(peer.asked) == sorted(peer.clips)
    assert len(rests) == 1 + 3
    assert len(scanned) == 2 * 3 + 2, "of each batch when it is read and when it is judged; and for what is written"
    for clip in clips:
        whole, first = list(clip.plaintexts), clip.record_id == peer.asked[-1]
        expected = [None, *whole[1:]] if first else whole
        assert read_all(clip, await house.custodian.export(clip.record_id)) == expected
    assert (await desk.scrub()).is_clean


async def test_an_erased_clip_leaves_no_blob_and_an_erased_picture_no_bytes(
    house: CustodianHarness, tmp_path: Path
) -> None:
    gone, cut = await house.keep(), await house.keep()
    before, path = await path_of(house, cut, tmp_path), await path_of(house, gone, tmp_path)
    await house.follow(erasure(ERASURE_ID, gone), erasure(b"\xe2" * 32, cut, frames=(1,)))
    assert not path.exists()
    assert not before.exists()
    texts = cut.upload.ciphertexts
    assert (await path_of(house, cut, tmp_path)).read_bytes() == texts[0] + texts[2]
    assert read_all(cut, await house.custodian.export(cut.record_id))[1] is None


async def test_a_clip_is_kept_and_read_by_one_call_and_erased_by_two(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is a round trip to an S3 server, which an erasure and its receipt wait for."""
    store: Any = house.store
    calls: list[str] = []

    def counted(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *given: calls.append(name) or original(*given)

    for name in ("put", "get", "delete", "has", "names"):
        monkeypatch.setattr(store._blobs, name, counted(name, getattr(store._blobs, name)))
    clip, unclaimed = await house.keep(), record_clip()
    assert calls == ["put"]
    await house.custodian.export(clip.record_id)
    assert calls == ["put", "get"]
    await house.follow(erasure(ERASURE_ID, clip))
    assert calls == ["put", "get", "delete", "names"]
    await house.custodian.stage(unclaimed.upload)
    calls.clear()
    await store.drop_staged([unclaimed.record_id])
    assert calls == ["delete", "names"]


async def test_blobs_of_one_erasure_are_deleted_many_at_once_but_not_all(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One after the other, the clips of a few robots that expire together would take longer than the time between."""
    clips = [record_clip() for _ in range(AT_ONCE_COUNT + 4)]
    for clip in clips:
        await house.custodian.stage(clip.upload)
    await house.follow(*(recorded(clip, expires_at_ms=EXPIRES_MS) for clip in clips))
    store: Any = house.store
    delete, at_once = store._blobs.delete, [0]

    async def counted(name: str) -> None:
        at_once.append(at_once[-1] + 1)
        await delete(name)
        at_once.append(at_once[-1] - 1)

    monkeypatch.setattr(store._blobs, "delete", counted)
    await house.follow(at_ms=EXPIRES_MS)
    assert max(at_once) == AT_ONCE_COUNT
    assert [name async for name in store._blobs.names()] == [OWNER_NAME]
    assert house.keys.held_count == 0


async def test_of_many_calls_the_first_that_fails_ends_the_others_before_it_is_told() -> None:
    """Else a write that is given up would go on beside the next one."""
    begun, ended = list[int](), list[int]()

    async def call(number: int) -> None:
        begun.append(number)
        try:
            await asyncio.sleep(0 if number == 1 else 60)
            raise BlockRobotError("STORE_UNAVAILABLE")
        finally:
            ended.append(number)

    with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE"):
        await for_each(range(100), call)
    assert sorted(ended) == sorted(begun) == list(range(AT_ONCE_COUNT))


async def test_a_sweep_looks_many_blobs_up_together_and_spares_what_is_written_meanwhile(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips, store = [await house.keep() for _ in range(5)], house.store
    assert isinstance(store, BlobBackedStore)
    monkeypatch.setattr(blob_backed_store, "NAMES_AT_ONCE_COUNT", 4)
    orphans = [store._names.name(clip.record_id, new_generation()) for clip in clips[:2]]
    coming = store._names.name(b"?" * 16, new_generation())
    store._in_flight.add(coming)
    for name in (*orphans, coming):
        await store._blobs.put(name, b"left")
    references, asked = store._index.references, list[int]()

    async def counted(record_ids: Sequence[bytes], size_bytes: int) -> dict[bytes, set[bytes]]:
        asked.append(len(record_ids))
        return await references(record_ids, size_bytes)

    monkeypatch.setattr(store._index, "references", counted)
    assert await store.sweep_blobs() == len(orphans)
    assert len(asked) == 3
    assert 1 < max(asked) <= 4
    left = {name async for name in store._blobs.names()}
    assert coming in left
    assert not left & set(orphans)
    for clip in clips:
        assert read_all(clip, await house.custodian.export(clip.record_id)) == list(clip.plaintexts)


async def test_a_blob_that_is_there_after_it_was_deleted_is_no_erasure(
    house: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = await house.keep()
    store: Any = house.store
    path, block = await path_of(house, clip, tmp_path), house.chain.block(erasure(ERASURE_ID, clip))

    async def forget(_name: str) -> None:
        """Say yes, and do nothing."""

    with monkeypatch.context() as patch:
        patch.setattr(store._blobs, "delete", forget)
        await refused("STORE_UNAVAILABLE", house.custodian.on_finalized_block(block))
        assert path.exists()
        assert await house.ready_outbox() == []
    await house.custodian.on_finalized_block(block)
    assert not path.exists()
    assert [name for name, _ in await house.ready_outbox()] == ["erasure.receipt"]


async def test_blobs_that_no_row_names_go_with_their_clip(house: CustodianHarness, tmp_path: Path) -> None:
    clip = await house.keep()
    store: Any = house.store
    left = [store._names.name(clip.record_id, new_generation()) for _ in range(3)]
    for name in left:
        await store._blobs.put(name, b"left by a crash")
    await house.follow(erasure(ERASURE_ID, clip))
    assert [name async for name in store._blobs.names()] == [OWNER_NAME]


async def test_however_many_blobs_somebody_puts_under_a_clips_name_it_is_erased(
    house: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blob_backed_store, "LISTED_MAX_COUNT", 3)
    clip = await house.keep()
    path = await path_of(house, clip, tmp_path)
    for number in range(10):
        path.with_name(f"{path.name[:-16]}{number:016x}").write_bytes(b"x")
    await house.follow(erasure(ERASURE_ID, clip))
    assert [call for call, _ in await house.ready_outbox()] == ["erasure.receipt"]
    assert [*path.parent.iterdir()] == []


async def test_blobs_that_no_row_names_are_swept_and_others_names_are_left_alone(
    house: CustodianHarness, tmp_path: Path
) -> None:
    clip, store = await house.keep(), house.store
    assert isinstance(store, BlobBackedStore)
    orphans = [store._names.name(record_id, new_generation()) for record_id in (clip.record_id, b"?" * 16)]
    foreign = BlobNames(KEY).name(b"!" * 16, new_generation())
    for name in (*orphans, foreign, "ab/notes.txt"):
        await store._blobs.put(name, b"left")
    assert (await CustodyHarness(house).scrub()).unknown_to_chain == [clip.record_id]
    assert await store.sweep_blobs() == 0
    left = {name async for name in store._blobs.names()}
    assert {foreign, "ab/notes.txt", OWNER_NAME} < left
    assert not left & set(orphans)
    assert read_all(clip, await house.custodian.export(clip.record_id)) == list(clip.plaintexts)


async def test_clips_from_before_the_blob_store_are_read_and_erased_as_ever(tmp_path: Path) -> None:
    keys = tmp_path / "erase-keys"
    inside = CustodianHarness(lambda: open_store("sqlite", tmp_path / "custody"), keys)
    async with inside.open():
        kept, gone = await inside.keep(), await inside.keep()
    apart = CustodianHarness(
        lambda: open_store("sqlite", tmp_path / "custody", clips=read_place("folder", tmp_path)), keys
    )
    apart.chain = inside.chain
    async with apart.open() as custodian:
        await apart.follow(erasure(ERASURE_ID, gone), access(ACCESS_ID, kept))
        assert read_all(kept, await custodian.download(kept.record_id, ACCESS_ID, ALICE)) == list(kept.plaintexts)
        await refused("CLIP_ERASED", custodian.export(gone.record_id))


async def test_a_place_of_another_custodian_is_refused_and_so_is_an_index_without_its_place(tmp_path: Path) -> None:
    place = read_place("folder:blobs", tmp_path)
    async with open_store("sqlite", tmp_path / "one", clips=place):
        pass
    with pytest.raises(BlockRobotError, match="another custodian's"):
        async with open_store("sqlite", tmp_path / "two", clips=place):
            pass
    for clips in (None, read_place("folder:elsewhere", tmp_path)):
        with pytest.raises(BlockRobotError, match="are in folder:blobs"):
            open_store("sqlite", tmp_path / "one", clips=clips)
    (tmp_path / "one" / PLACE_FILE_NAME).write_text('{"url": "folder:blobs", "names_key": "00"}')
    with pytest.raises(BlockRobotError, match="damaged"):
        open_store("sqlite", tmp_path / "one", clips=place)


@pytest.mark.parametrize("has_mount_point", [True, False])
async def test_a_disk_that_is_not_mounted_at_the_start_is_no_empty_place(tmp_path: Path, has_mount_point: bool) -> None:
    place, disk = tmp_path / "blobs", tmp_path / "disk"
    house = CustodianHarness(
        lambda: open_store("sqlite", tmp_path / "custody", clips=read_place("folder:blobs", tmp_path)),
        tmp_path / "keys",
    )
    async with house.open():
        gone, kept = await house.keep(), await house.keep()
    place.rename(disk)
    if has_mount_point:
        place.mkdir()
    for _ in range(2):
        with pytest.raises(BlockRobotError, match=r"^CLIPS_NOT_THERE: .*folder:blobs"):
            async with house.open():
                pass
    assert place.exists() == has_mount_point
    assert not has_mount_point or not list(place.iterdir())
    if has_mount_point:
        place.rmdir()
    disk.rename(place)
    async with house.open() as custodian:
        await house.follow(erasure(ERASURE_ID, gone))
        assert read_all(kept, await custodian.export(kept.record_id)) == list(kept.plaintexts)
    assert len([path for path in place.rglob("*") if path.is_file()]) == 2


async def test_of_a_disk_that_goes_while_the_node_runs_nothing_is_erased_lost_or_kept_beside_it(
    house: CustodianHarness, tmp_path: Path
) -> None:
    place, disk = tmp_path / "blobs", tmp_path / "disk"
    gone, cut, new = await house.keep(), await house.keep(), record_clip()
    block = house.chain.block(erasure(ERASURE_ID, gone), erasure(b"\xe2" * 32, cut, frames=(1,)))
    whole = (await path_of(house, gone, tmp_path)).read_bytes()
    place.rename(disk)
    place.mkdir()
    await refused("STORE_UNAVAILABLE", house.custodian.stage(new.upload))
    await refused("STORE_UNAVAILABLE", house.custodian.export(cut.record_id))
    await refused("STORE_UNAVAILABLE", house.custodian.on_finalized_block(block))
    assert await house.ready_outbox() == []
    assert not list(place.iterdir())
    place.rmdir()
    disk.rename(place)
    assert (await path_of(house, gone, tmp_path)).read_bytes() == whole
    await house.custodian.on_finalized_block(block)
    assert len(await house.ready_outbox()) == 2
    assert read_all(cut, await house.custodian.export(cut.record_id)) == [cut.plaintexts[0], None, cut.plaintexts[2]]
    left = [path for path in place.rglob("*") if path.is_file()]
    assert sorted(left) == sorted([place / OWNER_NAME, await path_of(house, cut, tmp_path)])


async def test_a_place_that_is_said_to_be_lost_is_filled_again_from_the_others(tmp_path: Path) -> None:
    """As docs/how-to/custody.md has it: an empty file of the owner's name in a new folder."""
    place = tmp_path / "blobs"
    house = CustodianHarness(
        lambda: open_store("sqlite", tmp_path / "custody", clips=read_place("folder:blobs", tmp_path)),
        tmp_path / "keys",
    )
    clip, desk = record_clip(), CustodyHarness(house)
    async with house.open():
        await desk.hold(clip)
    place.rename(tmp_path / "broken disk")
    place.mkdir()
    (place / OWNER_NAME).touch()
    async with house.open():
        assert {record_id for record_id, _ in (await desk.scrub()).corrupted} == {clip.record_id}
        assert (await desk.rebuild(Peer(clip))).is_whole
        assert await desk.opens(clip)
    async with house.open():
        assert (await desk.scrub()).is_clean
    with pytest.raises(BlockRobotError, match="another custodian's"):
        async with open_store("sqlite", tmp_path / "other", clips=read_place("folder:blobs", tmp_path)):
            pass


async def test_a_first_start_that_is_cut_off_may_name_another_place(tmp_path: Path) -> None:
    for name in ("folder:one", "folder:other"):
        open_store("sqlite", tmp_path / "custody", clips=read_place(name, tmp_path))
    async with open_store("sqlite", tmp_path / "custody", clips=read_place("folder:other", tmp_path)):
        pass
    assert not (tmp_path / "one").exists()
    with pytest.raises(BlockRobotError, match="are in folder:other"):
        open_store("sqlite", tmp_path / "custody", clips=read_place("folder:one", tmp_path))


@pytest.mark.parametrize("error", [errno.EIO, errno.EACCES])
async def test_a_folder_that_cannot_be_read_is_no_empty_one(
    house: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    """An erasure's read-back would see nothing in it."""
    clip, store, scandir = await house.keep(), house.store, os.scandir
    assert isinstance(store, BlobBackedStore)
    await store._blobs.put(store._names.name(clip.record_id, new_generation()), b"left by a crash")
    folder = store._names.prefix(clip.record_id).rpartition("/")[0]
    block = house.chain.block(erasure(ERASURE_ID, clip))

    def failing(path: Any) -> Any:
        if Path(path) == tmp_path / "blobs" / folder:
            raise OSError(error, os.strerror(error))
        return scandir(path)

    with monkeypatch.context() as patch:
        patch.setattr(os, "scandir", failing)
        await refused("STORE_UNAVAILABLE", house.custodian.on_finalized_block(block))
        await refused("STORE_UNAVAILABLE", store.sweep_blobs())
        assert await house.ready_outbox() == []
    await house.custodian.on_finalized_block(block)
    assert [name async for name in store._blobs.names()] == [OWNER_NAME]
    assert [name async for name in store._blobs.names("no/ne")] == []


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("s3:bucket", ""),
        ("s3://key:secret@bucket/x", ""),
        ("s3://bucket/x?versionId=1", ""),
        ("ftp://bucket", ""),
        ("", ""),
        ("s3://bucket/x", "http://storage.example:9000"),
        ("s3://bucket/x", "https://key:secret@storage.example"),
        ("s3://bucket/x", "storage.example"),
    ],
)
def test_places_that_are_none_are_refused_without_their_keys(url: str, endpoint: str, tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID") as refusal:
        read_place(url, tmp_path, endpoint=endpoint)
    assert "secret" not in str(refusal.value)


@given(record_id=st.binary(min_size=16, max_size=16), generation=st.binary(min_size=8, max_size=8))
def test_a_name_is_read_back_by_its_key_alone(record_id: bytes, generation: bytes) -> None:
    name = BlobNames(KEY).name(record_id, generation)
    assert BlobNames(KEY).read(name) == (record_id, generation)
    assert BlobNames(b"j" * 32).read(name) is None
    assert name.startswith(BlobNames(KEY).prefix(record_id))
    assert BlobNames(KEY).read(name[:-1]) is None


def test_every_method_of_a_store_that_takes_or_gives_frames_is_the_wrappers_own() -> None:
    protocols = (CustodyStore, ShareStore, UploadAccount)
    told = {
        name: str(value.__annotations__)
        for protocol in protocols
        for name, value in vars(protocol).items()
        if not name.startswith("_")
    }
    own = {name for name in vars(BlobBackedStore) if not name.startswith("_")}
    assert {name for name, types in told.items() if "FrameRow" in types} <= own <= set(told)
    assert {"erase_frames", "erase_clips", "drop_staged", "sweep_blobs"} <= own
