"""The file of erase keys: slots, crashes, damage, and that what was erased is in no file any more."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.custody.custodian import Custodian
from node.custody.erase_keys import (
    ERASE_KEY_BYTES,
    ERASE_KEYS_FILE_NAME,
    HEADER_BYTES,
    PAGE_SLOTS_COUNT,
    EraseKeys,
    unwrap_key,
    wrap_key,
)
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.small_chain import CUSTODIAN, SmallChain, erasure, record_clip, recorded

RECORD_ID = bytes(range(16))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / ERASE_KEYS_FILE_NAME


def code_of(error: pytest.ExceptionInfo[BlockRobotError]) -> str:
    return error.value.code


def test_keys_are_there_after_reopening(tmp_path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        taken = keys.allocate(5)
    assert len({key for _, key in taken}) == 5
    assert len({slot for slot, _ in taken}) == 5
    with EraseKeys(tmp_path) as keys:
        assert [keys.read(slot) for slot, _ in taken] == [key for _, key in taken]
        assert keys.held_count == 5


def test_a_destroyed_key_is_gone_from_the_file_at_once(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        (lost, lost_key), (kept, kept_key) = keys.allocate(2)
        assert lost_key in path.read_bytes()
        for _ in range(2):
            keys.destroy([lost])
        assert keys.read(lost) is None
        assert lost_key not in path.read_bytes()
        assert keys.read(kept) == kept_key


def test_a_destroyed_slot_is_given_out_again_only_after_its_release(tmp_path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        [(slot, _)] = keys.allocate(1)
        keys.destroy([slot])
        assert slot not in [taken for taken, _ in keys.allocate(10)]
        keys.release([slot])
        assert slot in [taken for taken, _ in keys.allocate(10)]


def test_releasing_a_slot_that_holds_a_key_does_nothing(tmp_path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        [(slot, key)] = keys.allocate(1)
        keys.release([slot])
        assert slot not in [taken for taken, _ in keys.allocate(10)]
        assert keys.read(slot) == key


def test_the_file_grows_by_whole_pages(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        assert path.stat().st_size == HEADER_BYTES
        first = keys.allocate(PAGE_SLOTS_COUNT)
        one_page = path.stat().st_size
        second = keys.allocate(1)
        assert path.stat().st_size - one_page == one_page - HEADER_BYTES
    with EraseKeys(tmp_path) as keys:
        assert [keys.read(slot) for slot, _ in (first[0], first[-1], second[0])] == [
            first[0][1],
            first[-1][1],
            second[0][1],
        ]


def test_the_file_is_for_its_owner_alone(tmp_path: Path) -> None:
    with EraseKeys(tmp_path / "erase-keys"):
        assert stat.S_IMODE((tmp_path / "erase-keys").stat().st_mode) == 0o700
        assert stat.S_IMODE((tmp_path / "erase-keys" / ERASE_KEYS_FILE_NAME).stat().st_mode) == 0o600


def test_two_custodians_never_share_the_file(tmp_path: Path) -> None:
    with EraseKeys(tmp_path):
        with pytest.raises(BlockRobotError) as refusal:
            EraseKeys(tmp_path)
        assert code_of(refusal) == "DATA_DIRECTORY_IN_USE"
    EraseKeys(tmp_path).close()


@pytest.mark.parametrize("place", [0, 8, 10, 12, 20, 40, 70, HEADER_BYTES - 1])
def test_any_damage_to_the_header_is_noticed(tmp_path: Path, path: Path, place: int) -> None:
    with EraseKeys(tmp_path) as keys:
        keys.allocate(1)
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(BlockRobotError) as refusal:
        EraseKeys(tmp_path)
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"
    assert path.read_bytes() == content


def test_a_file_that_was_cut_is_noticed(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        keys.allocate(1)
    os.truncate(path, path.stat().st_size - 1)
    with pytest.raises(BlockRobotError) as refusal:
        EraseKeys(tmp_path)
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"


def test_a_slot_of_unknown_state_is_noticed(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        keys.allocate(1)
    content = bytearray(path.read_bytes())
    content[HEADER_BYTES] = 7
    path.write_bytes(content)
    with pytest.raises(BlockRobotError) as refusal:
        EraseKeys(tmp_path)
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"


def test_a_crash_while_the_file_was_made_leaves_one_that_opens(tmp_path: Path, path: Path) -> None:
    path.write_bytes(bytes(HEADER_BYTES))
    with EraseKeys(tmp_path) as keys:
        [(slot, key)] = keys.allocate(1)
        assert keys.read(slot) == key


def test_a_crash_while_a_page_was_added_leaves_the_pages_before(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        [(slot, key)] = keys.allocate(1)
        whole = path.stat().st_size
    with path.open("ab") as file:
        file.write(b"\x01" * 5000)
    with EraseKeys(tmp_path) as keys:
        assert path.stat().st_size == whole
        assert keys.read(slot) == key
        assert keys.held_count == 1


def test_a_crash_between_random_bytes_and_zeros_destroyed_the_key_already(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with EraseKeys(tmp_path) as keys:
        [(slot, key)] = keys.allocate(1)
        syncs: list[int] = []

        def fail_at_second(_: int) -> None:
            syncs.append(1)
            if len(syncs) == 2:
                raise OSError(5, "Input/output error")

        with monkeypatch.context() as patches:
            patches.setattr(os, "fsync", fail_at_second)
            with pytest.raises(BlockRobotError) as refusal:
                keys.destroy([slot])
        assert code_of(refusal) == "ERASE_KEYS_DAMAGED"
    assert key not in path.read_bytes()


def test_no_key_is_given_out_before_it_is_on_the_medium(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with EraseKeys(tmp_path) as keys:
        keys.allocate(1)

        def fail(_: int) -> None:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(os, "fsync", fail)
        with pytest.raises(BlockRobotError) as refusal:
            keys.allocate(1)
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"


def test_a_disk_that_keeps_old_bytes_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with EraseKeys(tmp_path) as keys:
        [(slot, _)] = keys.allocate(1)
        monkeypatch.setattr(os, "pwrite", lambda _file, data, _offset: len(data))
        with pytest.raises(BlockRobotError) as refusal:
            keys.destroy([slot])
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"


def test_a_full_disk_gives_out_no_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_file: int, _data: bytes, _offset: int) -> int:
        raise OSError(28, "No space left on device")

    with EraseKeys(tmp_path) as keys:
        monkeypatch.setattr(os, "pwrite", full)
        with pytest.raises(BlockRobotError) as refusal:
            keys.allocate(1)
    assert code_of(refusal) == "ERASE_KEYS_DAMAGED"


def test_keys_that_nothing_refers_to_are_destroyed(tmp_path: Path, path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        (kept, kept_key), (orphan, orphan_key), (half, _) = keys.allocate(3)
        keys.destroy([half])
    with EraseKeys(tmp_path) as keys:
        assert keys.reconcile([kept]) == 2
        assert keys.read(kept) == kept_key
        assert orphan_key not in path.read_bytes()
        assert {orphan, half} <= {slot for slot, _ in keys.allocate(2)}


def test_slots_outside_the_file_hold_nothing(tmp_path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        keys.allocate(1)
        assert keys.read(-1) is None
        assert keys.read(10**9) is None
        keys.destroy([-1, 10**9])
        assert keys.held_count == 1


def test_a_wrapped_key_opens_only_in_its_place() -> None:
    erase_key, sealed = bytes(range(32)), b"sealed" * 13
    wrapped = wrap_key(erase_key, RECORD_ID, 3, sealed)
    assert unwrap_key(erase_key, RECORD_ID, 3, wrapped) == sealed
    assert wrapped != wrap_key(erase_key, RECORD_ID, 3, sealed)
    elsewhere = [
        (bytes(32), RECORD_ID, 3, wrapped),
        (erase_key, bytes(16), 3, wrapped),
        (erase_key, RECORD_ID, 4, wrapped),
        (erase_key, RECORD_ID, 3, wrapped[:-1] + bytes((wrapped[-1] ^ 1,))),
        (erase_key, RECORD_ID, 3, b""),
    ]
    for arguments in elsewhere:
        with pytest.raises(BlockRobotError) as refusal:
            unwrap_key(*arguments)
        assert code_of(refusal) == "ENVELOPE_INVALID"


def files_that_hold(needle: bytes, *folders: Path) -> list[str]:
    return [
        path.name for folder in folders for path in folder.rglob("*") if path.is_file() and needle in path.read_bytes()
    ]


async def test_what_was_erased_is_in_no_file_of_the_custodian(tmp_path: Path) -> None:
    """Frames erased one by one and a record erased whole: neither key nor wrapped key nor ciphertext stays, anywhere."""
    chain, (cut, gone, kept) = SmallChain(), [record_clip(3) for _ in range(3)]
    custody, secret = tmp_path / "custody", tmp_path / "erase-keys"
    async with SqliteStore(custody) as store:
        with EraseKeys(secret) as keys:
            custodian = Custodian(store, keys, member=CUSTODIAN, clock_ms=lambda: chain.time_ms)
            for clip in (cut, gone, kept):
                await custodian.stage(clip.upload)
            await custodian.on_finalized_block(chain.block(*(recorded(clip) for clip in (cut, gone, kept))))
            rows = {clip.record_id: await store.frames(clip.record_id) for clip in (cut, gone, kept)}
            erased = [rows[cut.record_id][1], *rows[gone.record_id]]
            remaining = [rows[cut.record_id][0], *rows[kept.record_id]]
            erase_keys = {row.slot: keys.read(row.slot) for row in erased + remaining}
            for row in erased:
                assert files_that_hold(row.ciphertext[:64], custody)
                assert files_that_hold(erase_keys[row.slot], secret)
            requests = (erasure(b"\x01" * 32, cut, frames=(1,)), erasure(b"\x02" * 32, gone))
            await custodian.on_finalized_block(chain.block(*requests))
            for row in erased:
                for needle in (row.ciphertext[:64], row.ciphertext[-64:], row.wrapped_key[:48], erase_keys[row.slot]):
                    assert files_that_hold(needle, custody, secret) == []
            for leaf in (*gone.leaves, *gone.upload.commitment_leaves):
                assert files_that_hold(leaf, custody, secret) == []
            for row in remaining:
                assert files_that_hold(row.ciphertext[:64], custody)
                assert files_that_hold(erase_keys[row.slot], secret)


def test_what_a_crash_wrote_into_a_slot_that_nobody_holds_is_seen_and_wiped(tmp_path: Path) -> None:
    """`allocate` writes the key before it says that the slot holds one: in between, the power may fail."""
    with EraseKeys(tmp_path) as keys:
        ((slot, _),) = keys.allocate(1)
        assert (keys.held, keys.capacity_count, keys.check_destroyed()) == ([slot], PAGE_SLOTS_COUNT, 0)
    path = tmp_path / ERASE_KEYS_FILE_NAME
    content = bytearray(path.read_bytes())
    place = HEADER_BYTES + PAGE_SLOTS_COUNT + 7 * ERASE_KEY_BYTES
    content[place : place + ERASE_KEY_BYTES] = b"\x07" * ERASE_KEY_BYTES
    path.write_bytes(bytes(content))
    with EraseKeys(tmp_path) as keys:
        assert keys.check_destroyed() == 1
        assert keys.reconcile([slot]) == 0
        assert keys.check_destroyed() == 0
        assert keys.read(slot) is not None


def test_keys_that_nothing_marks_are_found_beyond_the_marks_too(tmp_path: Path) -> None:
    with EraseKeys(tmp_path) as keys:
        slots = [slot for slot, _ in keys.allocate(5)]
        keys.destroy(slots[3:4])
        claimed = bytearray(slots[2] + 1)
        claimed[slots[0]] = True
        assert keys.find_unclaimed(claimed) == [slots[1], slots[2], slots[4]]
        assert len(claimed) == slots[2] + 1
        assert keys.find_unclaimed(bytearray(b"\x01" * keys.capacity_count)) == []
