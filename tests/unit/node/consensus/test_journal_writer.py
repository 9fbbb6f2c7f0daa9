"""The recorder and the real journal: what a snapshot stands for goes, what comes later stays, in every order."""

from __future__ import annotations

import asyncio

import pytest

from node.consensus.journal import Journal
from node.consensus.journal_writer import JournalWriter
from tests.unit.node.consensus.test_journal import IDENTITY, PATH, FakeDisk, reopened
from tests.virtual_time import in_virtual_time


class Stage:
    """A recorder on a journal on a disk; `said` is what the core would put into a snapshot."""

    def __init__(self) -> None:
        self.disk = FakeDisk()
        self.said: list[bytes] = []
        self.told: list[str] = []
        self.recorder = JournalWriter(
            Journal.create(PATH, disk=self.disk, identity=IDENTITY),
            stopwatch=lambda: 0.0,
            snapshot=lambda: [b"+".join(self.said)],
            on_outage=lambda _: self.told.append("outage"),
            on_recovery=lambda: self.told.append("recovery"),
        )

    def say(self, *words: bytes, sync: bool = True) -> None:
        self.said += words
        self.recorder.append(words)
        if sync:
            self.recorder.sync()
            self.recorder.complete_sync()

    def survives(self) -> list[bytes]:
        self.disk.crash()
        return reopened(self.disk)


@in_virtual_time
async def test_rewriting_twice_leaves_one_snapshot_and_what_came_after_it() -> None:
    stage = Stage()
    stage.say(b"1", b"2")
    stage.recorder.rewrite()
    stage.recorder.rewrite()
    stage.say(b"3")
    stage.recorder.rewrite()
    stage.say(b"4")
    assert stage.survives() == [b"1+2+3", b"4"]


@in_virtual_time
async def test_what_was_appended_and_not_synced_is_in_the_snapshot_and_not_twice_in_the_journal() -> None:
    stage = Stage()
    stage.say(b"1")
    stage.say(b"2", sync=False)
    stage.recorder.rewrite()
    stage.say(b"3")
    assert stage.survives() == [b"1+2", b"3"]


@pytest.mark.parametrize("fault", ["room", "sync_fails", "directory_sync_fails"])
@in_virtual_time
async def test_a_rewrite_that_the_disk_refuses_begins_an_outage_and_ends_with_the_whole_word(fault: str) -> None:
    stage = Stage()
    stage.say(b"1")
    setattr(stage.disk, fault, 0 if fault == "room" else True)
    stage.recorder.rewrite()
    assert stage.told == ["outage"]
    setattr(stage.disk, fault, None if fault == "room" else False)
    while stage.told[-1] != "recovery":  # noqa: ASYNC110 - written in a thread, which virtual time does not wait for
        await asyncio.sleep(1)
    stage.say(b"2")
    await stage.recorder.stop()
    assert stage.survives() == [b"1", b"2"]


@in_virtual_time
async def test_a_recorder_that_was_stopped_tries_no_more() -> None:
    stage = Stage()
    stage.disk.room = 0
    stage.say(b"1")
    await stage.recorder.stop()
    assert stage.told == ["outage"]
    assert stage.recorder._recovering is None
