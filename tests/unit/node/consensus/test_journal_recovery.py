"""R38: after a disk refused, the journal is written anew out of memory; whatever crash comes, a journal is there."""

from __future__ import annotations

import errno

import pytest

from consensus.chain.journal_records import LOCKOUT_RESTORED, encode_lockout_record, read_journal
from consensus.errors import BlockRobotError
from node.consensus.journal import DAMAGED_SUFFIX, Journal, open_journal
from tests.unit.node.consensus.test_journal import PATH, FakeDisk, code_of, journal_with, records_of, reopened


@pytest.fixture
def disk():
    return FakeDisk()


def broken_by_full_disk(disk) -> Journal:
    journal = journal_with(disk, b"1", b"2")
    disk.room = 4
    journal.append(b"3")
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    return journal


def test_a_full_disk_that_was_freed_takes_the_journal_again(disk):
    journal = broken_by_full_disk(disk)
    assert code_of(journal.append, b"4") == "JOURNAL_UNWRITABLE"
    assert code_of(journal.recover, [(0, b"1 2 3")]) == "JOURNAL_UNWRITABLE"
    disk.room = None
    journal.recover([(0, b"1 2 3")])
    journal.append(b"4")
    journal.sync()
    disk.crash()
    assert reopened(disk) == [b"1 2 3", b"4"]


def test_sequences_only_grow_over_a_recovery_and_a_closed_journal_is_not_recovered(disk):
    journal = broken_by_full_disk(disk)
    disk.room = None
    before = journal.next_sequence
    journal.recover([(0, b"1 2 3")])
    assert journal.synced_sequence >= before
    assert journal.append(b"4") == journal.synced_sequence + 1
    journal = journal_with(FakeDisk(), b"1")
    journal.close()
    assert code_of(journal.recover, [(0, b"1")]) == "JOURNAL_UNWRITABLE"


def test_a_sync_that_failed_is_not_trusted_afterwards(disk):
    """A second sync of the same file may report success for bytes that are gone: the file is left behind."""
    journal = journal_with(disk, b"1")
    failed = disk.names[PATH]
    disk.sync_fails = True
    journal.append(b"2")
    assert code_of(journal.sync) == "JOURNAL_UNWRITABLE"
    disk.sync_fails = False
    journal.recover([(0, b"1 2")])
    assert disk.names[PATH] is not failed
    disk.crash()
    assert reopened(disk) == [b"1 2"]


@pytest.mark.parametrize("fault", ["room", "sync_fails", "directory_sync_fails"])
def test_a_crash_in_the_middle_of_a_recovery_leaves_the_old_journal_or_the_new_one(disk, fault):
    journal = broken_by_full_disk(disk)
    disk.room = None
    setattr(disk, fault, 10 if fault == "room" else True)
    assert code_of(journal.recover, [(0, b"1 2 3")]) == "JOURNAL_UNWRITABLE"
    disk.crash()
    assert reopened(disk) == [b"1", b"2"]


def test_a_recovery_that_failed_half_way_is_tried_again(disk):
    journal = broken_by_full_disk(disk)
    disk.room = None
    disk.directory_sync_fails = True
    assert code_of(journal.recover, [(0, b"1 2 3")]) == "JOURNAL_UNWRITABLE"
    assert code_of(journal.append, b"4") == "JOURNAL_UNWRITABLE"
    disk.directory_sync_fails = False
    journal.recover([(0, b"1 2 3")])
    journal.append(b"4")
    journal.sync()
    disk.crash()
    assert reopened(disk) == [b"1 2 3", b"4"]


# The operator's flag


def lockout_of(journal: Journal) -> str | None:
    mark = read_journal(records_of(journal), 0).lockout
    return None if mark is None else mark.reason


WORD = encode_lockout_record(0, 7, None)


def test_without_the_flag_a_missing_or_damaged_journal_is_refused_and_the_flag_is_named(disk):
    with pytest.raises(BlockRobotError, match="JOURNAL_MISSING") as missing:
        open_journal(PATH, disk=disk)
    journal_with(disk, WORD).close()
    disk.names[PATH].content = bytes(100)
    with pytest.raises(BlockRobotError, match="JOURNAL_DAMAGED") as damaged:
        open_journal(PATH, disk=disk)
    assert "--restored" in missing.value.next_step
    assert "--restored" in damaged.value.next_step


def test_the_flag_marks_the_journal_and_keeps_what_it_says(disk):
    journal_with(disk, WORD).close()
    assert lockout_of(open_journal(PATH, disk=disk)) is None
    disk.crash()
    marked = open_journal(PATH, disk=disk, restored=True)
    assert lockout_of(marked) == LOCKOUT_RESTORED
    assert read_journal(records_of(marked), 0).last_voted_round == 7
    disk.crash()
    assert lockout_of(open_journal(PATH, disk=disk)) == LOCKOUT_RESTORED


def test_a_journal_made_anew_holds_the_mark_from_its_first_byte_on(disk):
    """A crash at any point of its making leaves no journal, or one that silences."""
    for fault in ("room", "sync_fails", "directory_sync_fails"):
        setattr(disk, fault, 30 if fault == "room" else True)
        assert code_of(open_journal, PATH, disk=disk, restored=True) == "JOURNAL_UNWRITABLE"
        disk.crash()
        assert code_of(open_journal, PATH, disk=disk) == "JOURNAL_MISSING"
    open_journal(PATH, disk=disk, restored=True)
    disk.crash()
    assert lockout_of(open_journal(PATH, disk=disk)) == LOCKOUT_RESTORED


def test_a_damaged_journal_is_kept_aside_when_it_is_made_anew(disk):
    journal_with(disk, WORD).close()
    disk.names[PATH].content = disk.names[PATH].durable = b"damage" * 20
    journal = open_journal(PATH, disk=disk, restored=True)
    assert lockout_of(journal) == LOCKOUT_RESTORED
    assert disk.names[PATH.with_name(PATH.name + DAMAGED_SUFFIX)].content == b"damage" * 20


def test_a_disk_that_refuses_keeps_a_restored_node_from_starting(disk):
    journal_with(disk, WORD).close()
    disk.room = 0
    assert code_of(open_journal, PATH, disk=disk, restored=True) == "JOURNAL_UNWRITABLE"
    disk.room = None
    disk.names[PATH].content = b""

    def refuse(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    disk.replace = refuse
    assert code_of(open_journal, PATH, disk=disk, restored=True) == "JOURNAL_UNWRITABLE"
