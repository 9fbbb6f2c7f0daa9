"""A simulated disk keeps what was synced, and of the rest no more than a real one might."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.sim.world.sim_disk import SimDisk
from node.consensus.journal import Journal

PATH = Path("/journal/votes.journal")


def make_disk(seed: int) -> SimDisk:
    return SimDisk(random.Random(seed))


@pytest.mark.parametrize("seed", range(20))
def test_synced_records_survive_a_power_cut_and_unsynced_ones_never_come_back_changed(seed: int) -> None:
    disk = make_disk(seed)
    journal = Journal.create(PATH, disk=disk, identity=bytes(16))
    journal.append(b"said")
    journal.sync()
    disk.cut_power()
    journal = Journal.open(PATH, disk=disk)
    journal.append(b"to be said")
    disk.before_sync = disk.cut_power
    journal.sync()
    disk.before_sync = lambda: None
    disk.cut_power()
    records = [entry.record for entry in Journal.open(PATH, disk=disk).entries]
    assert records in ([b"said"], [b"said", b"to be said"])


def test_a_cut_may_leave_a_part_of_what_was_not_synced_or_nothing() -> None:
    lengths = set()
    for seed in range(30):
        disk = make_disk(seed)
        file = disk.open(PATH, create=True)
        file.sync()
        disk.sync_directory(PATH.parent)
        file.append(bytes(8))
        disk.cut_power()
        lengths.add(len(disk.open(PATH, create=False).read_all()))
    assert {0, 8} <= lengths
    assert len(lengths) > 4


def test_a_renaming_that_was_not_synced_may_be_lost() -> None:
    names = set()
    for seed in range(20):
        disk = make_disk(seed)
        disk.open(PATH, create=True)
        disk.sync_directory(PATH.parent)
        disk.replace(PATH, PATH.with_name("other"))
        disk.cut_power()
        names.add(disk.exists(PATH))
    assert names == {True, False}


def test_a_full_disk_refuses_a_journal_which_then_says_so() -> None:
    disk = make_disk(1)
    journal = Journal.create(PATH, disk=disk, identity=bytes(16))
    disk.is_full = True
    journal.append(b"word")
    with pytest.raises(BlockRobotError, match="refuses the journal"):
        journal.sync()


def test_a_backup_put_back_forgets_what_was_said_since() -> None:
    disk = make_disk(1)
    journal = Journal.create(PATH, disk=disk, identity=bytes(16))
    backup = disk.image()
    journal.append(b"said since")
    journal.sync()
    disk.restore(backup)
    assert Journal.open(PATH, disk=disk).entries == ()
