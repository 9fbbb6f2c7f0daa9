"""Empty frames lie in the clear: kept only while they are approved, and deleted for good when that is withdrawn."""

from __future__ import annotations

import secrets
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import CustodianHarness, refused
from tests.offchain.small_chain import empty_frames_withdrawn
from tests.offchain.small_state import State


def approved() -> None:
    """Say yes."""


def withdrawn() -> None:
    raise BlockRobotError("EMPTY_FRAME_NOT_APPROVED")


async def put(house: CustodianHarness) -> tuple[bytes, bytes]:
    content = secrets.token_bytes(10_000)
    await house.custodian.put_background(sha256(content), content, None, approved)
    return sha256(content), content


async def test_an_empty_frame_is_kept_under_its_hash_and_no_other(opened: CustodianHarness) -> None:
    digest, content = await put(opened)
    assert await opened.custodian.get_background(digest) == content
    await refused("UPLOAD_HASH_MISMATCH", opened.custodian.put_background(bytes(32), content, None, approved))
    assert await opened.custodian.get_background(bytes(32)) is None


async def test_what_is_withdrawn_before_it_is_written_is_not_kept(opened: CustodianHarness) -> None:
    content = secrets.token_bytes(1_000)
    taken = opened.custodian.put_background(sha256(content), content, None, withdrawn)
    await refused("EMPTY_FRAME_NOT_APPROVED", taken)
    assert await opened.store.background_digests() == []


async def test_a_withdrawn_frame_is_deleted_with_its_block_and_the_others_stay(opened: CustodianHarness) -> None:
    first, second = await put(opened), await put(opened)
    await opened.follow(empty_frames_withdrawn(first[0], second[0], gone=(first[0],)))
    assert await opened.custodian.get_background(first[0]) is None
    assert await opened.custodian.get_background(second[0]) == second[1]
    await opened.follow(empty_frames_withdrawn(first[0], gone=(first[0],)))  # a custodian that never had it


@pytest.mark.parametrize("way", ["blocks", "state"])
async def test_a_custodian_that_lags_keeps_a_frame_that_is_approved_again(opened: CustodianHarness, way: str) -> None:
    """It was withdrawn, approved again and brought, by the newest final state; here that withdrawal is still to come."""
    again, gone = await put(opened), await put(opened)
    opened.approved_frames.add(again[0])
    if way == "state":
        await opened.custodian.reconcile(State().facts())
        assert await opened.store.background_digests() == [again[0]]
        return
    await opened.follow(empty_frames_withdrawn(again[0], gone[0], gone=(again[0], gone[0])))
    assert await opened.store.background_digests() == [again[0]]
    opened.approved_frames.clear()
    await opened.follow(empty_frames_withdrawn(again[0], gone=(again[0],)))
    assert await opened.store.background_digests() == []


async def test_nothing_of_a_withdrawn_frame_is_left_in_the_files_of_sqlite(tmp_path: Path) -> None:
    house = CustodianHarness(lambda: SqliteStore(tmp_path / "custody"), tmp_path / "erase-keys")
    async with house.open():
        digest, content = await put(house)
        await house.follow()
        piece = content[4_000:4_032]
        held = [path for path in (tmp_path / "custody").iterdir() if path.is_file()]
        assert any(piece in path.read_bytes() for path in held)
        await house.follow(empty_frames_withdrawn(digest, gone=(digest,)))
        assert not any(piece in path.read_bytes() for path in (tmp_path / "custody").iterdir() if path.is_file())


async def test_a_custodian_that_takes_the_state_instead_of_blocks_deletes_what_that_does_not_approve(
    opened: CustodianHarness,
) -> None:
    kept, gone = await put(opened), await put(opened)
    state = State()
    state.rows[b"records\x00empty-frame/" + kept[0]] = 1
    await opened.custodian.reconcile(state.facts())
    assert await opened.store.background_digests() == [kept[0]]
    assert await opened.custodian.get_background(gone[0]) is None


async def test_a_store_that_still_returns_a_deleted_frame_stops_the_block(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest, _ = await put(opened)
    before = await opened.custodian.checkpoint()

    async def forgets_nothing(digests: object) -> None:
        """Answer as if it were done."""

    monkeypatch.setattr(opened.store, "delete_backgrounds", forgets_nothing)
    await refused("STORE_UNAVAILABLE", opened.follow(empty_frames_withdrawn(digest, gone=(digest,))))
    assert await opened.custodian.checkpoint() == before
