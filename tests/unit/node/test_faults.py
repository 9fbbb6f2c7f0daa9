"""The fault switch: all of a request or nothing, kept over a kill, and a full disk that refuses as a real one does."""

from __future__ import annotations

import errno
import json
import stat
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.api_adapters import WallClock
from node.consensus.journal import Journal
from node.consensus.journal_disk import SystemDisk
from node.custody.stores.sqlite_store import SqliteStore
from node.faults import STATE_FILE_NAME, TOKEN_FILE_NAME, FaultSwitch, FillableDisk, read_or_make_token
from node.p2p.link_faults import LinkFault


def _switch(folder: Path, clock: WallClock | None = None) -> FaultSwitch:
    return FaultSwitch("node-1", folder, clock or WallClock())


def test_what_is_asked_for_is_on_and_what_is_not_named_stays(tmp_path: Path) -> None:
    clock = WallClock()
    switch = _switch(tmp_path, clock)
    switch.request(b'{"links": {"node-2": {"cut": true}, "node-3": {"delay_ms": 5}}, "seed": 4}')
    switch.request(b'{"clock_offset_ms": -3600000, "disk": {"journal": true}}')
    state = switch.request(b'{"links": {"node-2": null}}')
    assert state["links"] == {
        "node-3": {"delay_ms": 5.0, "jitter_ms": 0.0, "loss": 0.0, "bandwidth_bytes_per_s": 0, "cut": False}
    }
    assert (state["clock_offset_ms"], state["disk"], state["seed"]) == (-3_600_000, ["journal"], 4)
    assert clock.offset_ms == -3_600_000
    assert abs(clock.now_ms() + 3_600_000 - WallClock().now_ms()) < 1_000


def test_clear_ends_everything_and_what_comes_with_it_is_on(tmp_path: Path) -> None:
    clock = WallClock()
    switch = _switch(tmp_path, clock)
    switch.request(b'{"links": {"node-2": {"cut": true}}, "clock_offset_ms": 5, "disk": {"ledger": true}}')
    state = switch.request(b'{"clear": true, "disk": {"custody": true}}')
    assert (state["links"], state["clock_offset_ms"], state["disk"]) == ({}, 0, ["custody"])
    assert clock.offset_ms == 0


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"[]",
        b"{",
        b"\xff",
        b'{"unknown": 1}',
        b'{"links": {"node-2": {"delay_ms": -1}}}',
        b'{"links": {"node-2": {"delay_ms": "5"}}}',
        b'{"links": {"node-2": {"loss": 2}}}',
        b'{"links": {"node-2": {"speed": 2}}}',
        b'{"disk": {"floppy": true}}',
        b'{"clock_offset_ms": 1e300}',
        b'{"clock_offset_ms": 999999999999999}',
        json.dumps({"links": {f"node-{number}": {"cut": True} for number in range(65)}}).encode(),
    ],
)
def test_a_wrong_request_changes_nothing(tmp_path: Path, body: bytes) -> None:
    switch = _switch(tmp_path)
    before = switch.request(b'{"links": {"node-9": {"cut": true}}, "clock_offset_ms": 7}')
    with pytest.raises(BlockRobotError, match=r"^FAULT_INVALID:"):
        switch.request(body)
    assert switch.describe() == before


def test_a_half_wrong_request_does_not_do_its_first_half(tmp_path: Path) -> None:
    switch = _switch(tmp_path)
    with pytest.raises(BlockRobotError):
        switch.request(b'{"clear": true, "links": {"node-2": {"cut": true}, "node-3": {"loss": 1}}}')
    assert switch.describe()["links"] == {}
    assert not (tmp_path / STATE_FILE_NAME).exists()


def test_faults_are_still_on_after_a_kill_and_a_damaged_file_of_them_is_refused_by_name(tmp_path: Path) -> None:
    _switch(tmp_path).request(
        b'{"links": {"node-2": {"cut": true}}, "clock_offset_ms": 60000, "disk": {"journal": true}, "seed": 9}'
    )
    clock = WallClock()
    again = _switch(tmp_path, clock)
    assert again.shaper.faults == {"node-2": LinkFault(cut=True)}
    assert (clock.offset_ms, again.describe()["disk"], again.shaper.seed) == (60_000, ["journal"], 9)
    (tmp_path / STATE_FILE_NAME).write_bytes(b"{")
    with pytest.raises(BlockRobotError, match=STATE_FILE_NAME):
        _switch(tmp_path)


def test_a_journal_on_a_full_disk_refuses_as_on_a_real_one_and_holds_what_was_synced(tmp_path: Path) -> None:
    switch = _switch(tmp_path)
    disk = FillableDisk(SystemDisk(), switch, "journal")
    journal = Journal.create(tmp_path / "votes.journal", disk=disk)
    journal.append(b"one")
    journal.sync()
    switch.request(b'{"disk": {"journal": true}}')
    journal.append(b"two")
    with pytest.raises(BlockRobotError) as refused:
        journal.sync()
    assert refused.value.code == "JOURNAL_UNWRITABLE"
    assert isinstance(refused.value.__cause__, OSError)
    assert refused.value.__cause__.errno == errno.ENOSPC
    journal.close()
    reopened = Journal.open(tmp_path / "votes.journal", disk=disk)
    assert [entry.record for entry in reopened.entries] == [b"one"]
    reopened.close()


def test_a_full_disk_takes_no_new_file(tmp_path: Path) -> None:
    switch = _switch(tmp_path)
    disk = FillableDisk(SystemDisk(), switch, "journal")
    switch.request(b'{"disk": {"journal": true}}')
    with pytest.raises(OSError, match="No space"):
        disk.open(tmp_path / "new", create=True)
    assert not disk.exists(tmp_path / "new")


async def test_a_custody_store_on_a_full_disk_reads_and_does_not_write(tmp_path: Path) -> None:
    switch = _switch(tmp_path)
    async with SqliteStore(tmp_path / "custody", lambda: switch.require_space("custody")) as store:
        await store.put_background(b"d" * 32, b"picture")
        switch.request(b'{"disk": {"custody": true}}')
        with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE:"):
            await store.put_background(b"e" * 32, b"picture")
        assert await store.background(b"d" * 32) == b"picture"
        switch.request(b'{"disk": {"custody": false}}')
        await store.put_background(b"e" * 32, b"picture")


def test_a_token_is_made_once_for_its_owner_and_one_that_is_none_is_refused_unshown(tmp_path: Path) -> None:
    token = read_or_make_token(tmp_path)
    path = tmp_path / TOKEN_FILE_NAME
    assert len(token) == 64
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o644)
    assert read_or_make_token(tmp_path) == token
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    (tmp_path / TOKEN_FILE_NAME).write_text("short-secret", encoding="ascii")
    with pytest.raises(BlockRobotError) as refused:
        read_or_make_token(tmp_path)
    assert refused.value.code == "FILE_UNUSABLE"
    assert "short-secret" not in refused.value.detail
