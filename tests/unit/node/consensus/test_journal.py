"""The voting journal on a disk that crashes, tears writes and fills up."""

from __future__ import annotations

import errno
import threading
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.consensus import journal as module
from node.consensus.journal import Journal
from node.consensus.journal_disk import SystemDisk

PATH = Path("/journal/votes")
IDENTITY = b"sixteen bytes..."


class FakeFile:
    """`durable` is what a crash leaves for certain; `content` is what a reader sees before it."""

    def __init__(self, disk: FakeDisk) -> None:
        self.disk = disk
        self.content = b""
        self.durable = b""
        self.open = False

    def read_all(self) -> bytes:
        return self.content

    def append(self, data: bytes) -> None:
        if self.disk.room is not None and len(data) > self.disk.room:
            self.content += data[: self.disk.room]
            raise OSError(errno.ENOSPC, "No space left on device")
        self.content += data

    def truncate(self, size_bytes: int) -> None:
        self.content = self.content[:size_bytes]

    def sync(self) -> None:
        if self.disk.sync_fails:
            raise OSError(errno.EIO, "Input/output error")
        self.durable = self.content

    def close(self) -> None:
        self.open = False


class FakeDisk:
    """A disk whose names, too, are durable only once the directory is synced."""

    def __init__(self) -> None:
        self.names: dict[Path, FakeFile] = {}
        self.durable_names: dict[Path, FakeFile] = {}
        self.room: int | None = None
        self.sync_fails = False
        self.directory_sync_fails = False

    def exists(self, path: Path) -> bool:
        return path in self.names

    def open(self, path: Path, *, create: bool) -> FakeFile:
        if create:
            self.names[path] = FakeFile(self)
        if path not in self.names:
            raise FileNotFoundError(path)
        file = self.names[path]
        if file.open:
            raise BlockRobotError("DATA_DIRECTORY_IN_USE")
        file.open = True
        return file

    def replace(self, source: Path, target: Path) -> None:
        self.names[target] = self.names.pop(source)

    def remove(self, path: Path) -> None:
        del self.names[path]

    def sync_directory(self, directory: Path) -> None:
        if self.directory_sync_fails:
            raise OSError(errno.EIO, "Input/output error")
        self.durable_names = dict(self.names)

    def crash(self, torn: bytes | None = None) -> None:
        """Lose all that was not synced; of the journal's unsynced tail `torn` stays, if given."""
        self.names = dict(self.durable_names)
        for file in self.names.values():
            file.content = file.durable
            file.open = False
        if torn is not None:
            self.names[PATH].content += torn
        self.room, self.sync_fails, self.directory_sync_fails = None, False, False


@pytest.fixture
def disk():
    return FakeDisk()


def journal_with(disk, *records: bytes) -> Journal:
    journal = Journal.create(PATH, disk=disk, identity=IDENTITY)
    for record in records:
        journal.append(record)
    journal.sync()
    return journal


def records_of(journal: Journal) -> list[bytes]:
    return [entry.record for entry in journal.entries]


def reopened(disk) -> list[bytes]:
    journal = Journal.open(PATH, disk=disk)
    journal.close()
    return records_of(journal)


def code_of(call, *arguments, **options) -> str:
    with pytest.raises(BlockRobotError) as caught:
        call(*arguments, **options)
    return caught.value.code


def tail_of(disk, *records: bytes) -> bytes:
    """Return the bytes that appending these records would add, leaving the journal without them."""
    journal = Journal.open(PATH, disk=disk)
    before = len(disk.names[PATH].content)
    for record in records:
        journal.append(record)
    journal.sync()
    journal.close()
    tail = disk.names[PATH].content[before:]
    disk.names[PATH].content = disk.names[PATH].durable = disk.names[PATH].content[:before]
    return tail


def test_records_come_back_in_order_with_kind_and_sequence(disk):
    journal = Journal.create(PATH, disk=disk)
    assert [journal.append(b"vote %d" % number, kind=number) for number in range(5)] == [1, 2, 3, 4, 5]
    assert journal.sync() == 5
    journal.close()
    entries = Journal.open(PATH, disk=disk).entries
    assert [(entry.sequence, entry.kind, entry.record) for entry in entries] == [
        (number + 1, number, b"vote %d" % number) for number in range(5)
    ]


def test_what_was_synced_survives_a_crash_and_a_reopened_journal_goes_on_where_it_was(disk):
    journal = journal_with(disk, b"said")
    journal.append(b"not said")
    assert (journal.synced_sequence, journal.next_sequence) == (1, 3)
    disk.crash()
    assert reopened(disk) == [b"said"]
    disk = FakeDisk()
    journal_with(disk, b"one", b"two").close()
    journal = Journal.open(PATH, disk=disk)
    assert journal.append(b"three") == 3
    journal.sync()
    disk.crash()
    assert reopened(disk) == [b"one", b"two", b"three"]


def test_a_tail_torn_at_any_byte_is_cut_and_the_journal_goes_on(disk):
    journal_with(disk, b"first", b"second").close()
    before = disk.names[PATH].durable
    third = len(tail_of(disk, b"third"))
    tail = tail_of(disk, b"third", b"fourth")
    for kept in range(len(tail)):
        disk.names[PATH].durable = before
        disk.crash(torn=tail[:kept])
        journal = Journal.open(PATH, disk=disk)
        found = records_of(journal)
        assert found == ([b"first", b"second", b"third"] if kept >= third else [b"first", b"second"])
        journal.append(b"after")
        journal.sync()
        disk.crash()
        assert reopened(disk) == [*found, b"after"]


def test_a_tail_of_zeros_garbage_or_unsynced_records_out_of_order_is_cut(disk):
    journal_with(disk, b"first").close()
    for torn in (b"\x00" * 500, b"garbage" * 20, module._FRAME_MAGIC * 9):
        disk.crash(torn=torn)
        assert reopened(disk) == [b"first"]
    disk = FakeDisk()
    journal_with(disk, b"first").close()
    tail = tail_of(disk, b"second", b"third")
    half = len(tail) // 2
    disk.crash(torn=b"\x00" * half + tail[half:])
    assert reopened(disk) == [b"first"]


def test_every_changed_byte_of_a_synced_record_before_the_last_is_damage(disk):
    journal = journal_with(disk, b"first")
    start = len(disk.names[PATH].content)
    journal.append(b"second")
    journal.sync()
    end = len(disk.names[PATH].content)
    journal.append(b"third")
    journal.sync()
    journal.close()
    whole = disk.names[PATH].durable
    for position in range(start, end):
        changed = bytearray(whole)
        changed[position] ^= 0x41
        disk.names[PATH].durable = bytes(changed)
        disk.crash()
        assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"


def test_a_record_that_was_taken_out_is_damage(disk):
    journal = journal_with(disk, b"first")
    start = len(disk.names[PATH].content)
    journal.append(b"second")
    journal.sync()
    end = len(disk.names[PATH].content)
    journal.append(b"third")
    journal.sync()
    whole = disk.names[PATH].durable
    disk.names[PATH].durable = whole[:start] + whole[end:]
    disk.crash()
    assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"


def test_damage_of_the_head_is_refused_and_the_journal_left_as_it_is(disk):
    journal_with(disk, b"first").close()
    whole = disk.names[PATH].durable
    for changed in (b"", whole[:10], b"\x00" * len(whole), whole[:30] + b"?" + whole[31:]):
        disk.names[PATH].durable = changed
        disk.crash()
        assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"
    disk = FakeDisk()
    journal_with(disk, b"first", b"second").close()
    disk.names[PATH].content = disk.names[PATH].content[:-1] + b"?"
    before = disk.names[PATH].content[:20] + b"!" + disk.names[PATH].content[21:]
    disk.names[PATH].content = before
    assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"
    assert disk.names[PATH].content == before
    assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"


def test_bytes_inside_a_record_cannot_pose_as_a_frame(disk):
    other = FakeDisk()
    foreign = Journal.create(PATH, disk=other, identity=b"another identity")
    for number in range(9):
        foreign.append(b"forged %d" % number)
        foreign.sync()
    forged = other.names[PATH].content
    journal_with(disk, b"first").close()
    tail = tail_of(disk, forged)
    disk.crash(torn=tail[:-1])
    assert reopened(disk) == [b"first"]


def test_a_journal_has_one_owner_and_is_never_made_by_opening_or_over_another(disk):
    assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_MISSING"
    assert disk.names == {}
    journal_with(disk, b"first").close()
    assert code_of(Journal.create, PATH, disk=disk) == "DATA_DIRECTORY_INVALID"
    assert reopened(disk) == [b"first"]
    disk = FakeDisk()
    journal_with(disk, b"first")
    assert code_of(Journal.open, PATH, disk=disk) == "DATA_DIRECTORY_IN_USE"


def test_after_a_full_disk_nothing_is_signed_until_the_journal_is_opened_anew(disk):
    journal = journal_with(disk, b"first")
    journal.append(b"second")
    disk.room = 7
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    disk.room = None
    assert code_of(journal.append, b"third") == "JOURNAL_UNWRITABLE"
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    assert journal.synced_sequence == 1
    journal.close()
    assert reopened(disk) == [b"first"]


def test_a_failed_sync_is_never_taken_for_done(disk):
    journal = journal_with(disk, b"first")
    journal.append(b"second")
    disk.sync_fails = True
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    disk.sync_fails = False
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    assert journal.synced_sequence == 1


def test_a_disk_that_refuses_is_told_of_on_making_and_opening(disk):
    disk.room = 0
    assert code_of(Journal.create, PATH, disk=disk) == "JOURNAL_UNWRITABLE"
    disk.room = None
    disk.names.clear()
    journal_with(disk, b"first").close()
    disk.sync_fails = True
    assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_UNWRITABLE"


def test_compaction_keeps_what_is_named_and_goes_on_counting(disk):
    journal = journal_with(disk, b"1", b"2", b"3")
    size = journal.size_bytes
    journal.compact([(7, b"3")])
    assert journal.size_bytes < size
    assert journal.append(b"4") == 5
    journal.sync()
    disk.crash()
    again = Journal.open(PATH, disk=disk)
    assert [(entry.sequence, entry.kind, entry.record) for entry in again.entries] == [(4, 7, b"3"), (5, 0, b"4")]
    assert again.next_sequence == 6


def test_compaction_to_nothing_still_goes_on_counting(disk):
    journal = journal_with(disk, b"1", b"2")
    journal.compact([])
    disk.crash()
    again = Journal.open(PATH, disk=disk)
    assert (again.entries, again.next_sequence) == ((), 3)


def test_compaction_carries_over_what_came_after_the_choice_and_what_is_not_synced(disk):
    journal = journal_with(disk, b"1", b"2", b"3")
    journal.append(b"4")
    journal.compact([(0, b"kept of 1 and 2")], through=2)
    disk.crash()
    assert reopened(disk) == [b"kept of 1 and 2", b"3", b"4"]
    disk = FakeDisk()
    journal = journal_with(disk, b"1")
    sequence = journal.append(b"2")
    journal.compact([])
    assert journal.synced_sequence >= sequence
    disk.crash()
    assert reopened(disk) == [b"2"]


def test_a_crash_in_a_compaction_leaves_the_old_journal(disk):
    journal = journal_with(disk, b"1", b"2")
    disk.directory_sync_fails = True
    assert code_of(journal.compact, [(0, b"2")]) == "JOURNAL_UNWRITABLE"
    assert code_of(journal.append, b"3") == "JOURNAL_UNWRITABLE"
    disk.crash()
    assert reopened(disk) == [b"1", b"2"]


def test_a_compaction_without_room_leaves_the_journal_usable(disk):
    journal = journal_with(disk, b"1", b"2")
    disk.room = 10
    assert code_of(journal.compact, [(0, b"2")]) == "JOURNAL_UNWRITABLE"
    disk.room = None
    journal.append(b"3")
    journal.sync()
    journal.close()
    assert reopened(disk) == [b"1", b"2", b"3"]
    assert list(disk.names) == [PATH]


def test_damage_in_a_compacted_journal_is_never_taken_for_a_torn_tail(disk):
    journal = journal_with(disk, b"1")
    journal.compact([(0, b"first kept"), (0, b"last kept")])
    journal.close()
    whole = disk.names[PATH].durable
    for cut in (len(whole) - 1, len(whole) - 40):
        disk.names[PATH].durable = whole[:cut]
        disk.crash()
        assert code_of(Journal.open, PATH, disk=disk) == "JOURNAL_DAMAGED"


def test_records_out_of_bounds_are_refused(disk, monkeypatch):
    journal = journal_with(disk)
    monkeypatch.setattr(module, "RECORD_SIZE_MAX_BYTES", 10)
    with pytest.raises(ValueError, match="too large"):
        journal.append(b"x" * 11)
    for kind in (-1, 256):
        with pytest.raises(ValueError, match="one byte"):
            journal.append(b"x", kind=kind)
    with pytest.raises(ValueError, match="identity"):
        Journal.create(PATH.with_name("other"), disk=disk, identity=b"short")


def test_a_journal_at_its_largest_size_refuses_until_it_is_compacted(disk, monkeypatch):
    monkeypatch.setattr(module, "JOURNAL_SIZE_MAX_BYTES", 300)
    journal = journal_with(disk, b"x" * 100)
    assert code_of(journal.append, b"x" * 150) == "JOURNAL_UNWRITABLE"
    assert code_of(journal.compact, [(0, b"x" * 300)]) == "JOURNAL_UNWRITABLE"
    journal.compact([])
    journal.append(b"x" * 150)
    journal.sync()
    disk.crash()
    assert reopened(disk) == [b"x" * 150]


def test_a_closed_journal_refuses_and_closing_twice_is_harmless(disk):
    journal = journal_with(disk, b"1")
    journal.close()
    journal.close()
    assert code_of(journal.append, b"2") == "JOURNAL_UNWRITABLE"
    assert code_of(journal.compact, []) == "JOURNAL_UNWRITABLE"


def test_many_threads_may_append_and_sync(disk):
    journal = journal_with(disk)
    failures: list[int] = []

    def speak(voice: int) -> None:
        for number in range(50):
            sequence = journal.append(b"%d:%d" % (voice, number))
            if journal.sync() < sequence:
                failures.append(sequence)

    threads = [threading.Thread(target=speak, args=(voice,)) for voice in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    disk.crash()
    assert failures == []
    assert sorted(reopened(disk)) == sorted(b"%d:%d" % (voice, number) for voice in range(4) for number in range(50))


class TestOnTheSystemsDisk:
    def test_a_journal_lives_on_through_reopening_and_compaction(self, tmp_path):
        path = tmp_path / "votes"
        journal = Journal.create(path)
        for number in range(10):
            journal.append(b"vote %d" % number)
        journal.sync()
        journal.compact([(1, b"vote 9")])
        journal.append(b"vote 10")
        journal.sync()
        journal.close()
        again = Journal.open(path)
        assert records_of(again) == [b"vote 9", b"vote 10"]
        again.close()
        assert [item.name for item in tmp_path.iterdir()] == ["votes"]
        assert path.stat().st_mode & 0o077 == 0

    def test_a_torn_tail_is_cut_from_the_file(self, tmp_path):
        path = tmp_path / "votes"
        journal = Journal.create(path)
        journal.append(b"first")
        journal.sync()
        journal.close()
        size = path.stat().st_size
        with path.open("ab") as file:
            file.write(b"\xb1JRN torn")
        journal = Journal.open(path)
        journal.close()
        assert (records_of(journal), path.stat().st_size) == ([b"first"], size)

    def test_a_journal_has_one_owner_also_after_compaction(self, tmp_path):
        path = tmp_path / "votes"
        journal = Journal.create(path)
        assert code_of(Journal.open, path) == "DATA_DIRECTORY_IN_USE"
        journal.compact([(0, b"kept")])
        assert code_of(Journal.open, path) == "DATA_DIRECTORY_IN_USE"
        journal.close()
        Journal.open(path).close()

    def test_a_leftover_of_a_broken_compaction_is_removed(self, tmp_path):
        path = tmp_path / "votes"
        Journal.create(path).close()
        (tmp_path / "votes.new").write_bytes(b"half a journal")
        Journal.open(path).close()
        assert [item.name for item in tmp_path.iterdir()] == ["votes"]

    def test_a_missing_journal_or_directory_is_told_apart_from_a_full_disk(self, tmp_path):
        assert code_of(Journal.open, tmp_path / "votes") == "JOURNAL_MISSING"
        assert code_of(Journal.create, tmp_path / "missing" / "votes") == "JOURNAL_UNWRITABLE"
        assert not SystemDisk().exists(tmp_path / "votes")
