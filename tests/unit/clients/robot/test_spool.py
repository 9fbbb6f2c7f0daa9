"""The spool: a clip is there once or not at all, and nobody reads or changes it unnoticed."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.robot.identity.sealed_file import seal_content
from clients.robot.recording.spool import Spool, SpooledClip
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.records.clips import ClipUpload

KEY = bytes(range(32))
OWNER = b"\x02" + b"OWNER" * 6 + b"oo"


def clip(number: int = 0, size_bytes: int = 100) -> SpooledClip:
    return SpooledClip(
        upload=ClipUpload(
            record_id=number.to_bytes(16, "big"),
            txid=bytes(32),
            valid_until_ms=0,
            ciphertexts=[secrets.token_bytes(size_bytes)],
            sealed_keys=[bytes(80)],
            commitment_leaves=[bytes(32)],
            owner=OWNER,
        ),
        owner=OWNER,
        ephemeral=b"\x02" * 33,
        view_tag=7,
        purpose="demo",
        visit_bucket_ms=300_000,
        commitment_root=bytes(32),
        ciphertext_root=bytes(32),
        sealed_metadata=bytes(560),
        bucket_ms=300_000,
        expires_at_ms=10**12,
        frame_count=1,
        decided_at_ms=300_500,
        person=bytes(32),
        sensor="depth",
        captured_from_ms=300_100,
        captured_until_ms=300_400,
    )


def test_clips_come_back_oldest_first_after_a_restart(tmp_path: Path) -> None:
    clips = [clip(number) for number in range(12)]
    spool = Spool(tmp_path, KEY)
    for item in clips:
        spool.put(item)
    again = Spool(tmp_path, KEY)
    assert [again.get(name) for name in again.names()] == clips


def test_a_name_is_never_used_again_while_its_clip_waits(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY)
    first, second = spool.put(clip(1)), spool.put(clip(2))
    spool.remove(first)
    again = Spool(tmp_path, KEY)
    third = again.put(clip(3))
    assert third not in {first, second}
    assert again.names() == [second, third]


def test_a_removed_clip_is_gone_and_removing_it_twice_is_harmless(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY)
    name = spool.put(clip())
    spool.remove(name)
    spool.remove(name)
    assert (spool.names(), spool.size_bytes, list(tmp_path.iterdir())) == ([], 0, [])


def test_the_spool_knows_the_most_that_ever_waited(tmp_path: Path) -> None:
    spool = Spool(tmp_path, bytes(32))
    names = [spool.put(clip(number)) for number in range(3)]
    most = spool.size_bytes
    for name in names:
        spool.remove(name)
    spool.put(clip(4))
    assert 0 < spool.size_bytes < spool.peak_bytes == most


def test_the_file_tells_neither_owner_nor_purpose_and_two_clips_cannot_change_places(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY)
    first, second = tmp_path / spool.put(clip(1)), tmp_path / spool.put(clip(2))
    first.write_bytes(second.read_bytes())
    assert refusal(spool, first.name) == "SPOOL_DAMAGED"
    data = (tmp_path / spool.put(clip())).read_bytes()
    assert b"OWNER" not in data
    assert b"demo" not in data


@pytest.mark.parametrize("place", [0, 23, 24, 200, -1])
def test_a_changed_clip_is_not_delivered(tmp_path: Path, place: int) -> None:
    spool = Spool(tmp_path, KEY)
    path = tmp_path / spool.put(clip())
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert refusal(spool, path.name) == "SPOOL_DAMAGED"


@pytest.mark.parametrize("length", [0, 10, 24, 40, 500])
def test_a_torn_clip_is_not_delivered(tmp_path: Path, length: int) -> None:
    spool = Spool(tmp_path, KEY)
    path = tmp_path / spool.put(clip())
    path.write_bytes(path.read_bytes()[:length])
    assert refusal(spool, path.name) == "SPOOL_DAMAGED"


def test_a_clip_that_somebody_deleted_is_damage_and_no_crash(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY)
    path = tmp_path / spool.put(clip())
    path.unlink()
    assert refusal(spool, path.name) == "SPOOL_DAMAGED"


def test_another_robots_key_opens_nothing(tmp_path: Path) -> None:
    name = Spool(tmp_path, KEY).put(clip())
    assert refusal(Spool(tmp_path, bytes(32)), name) == "SPOOL_DAMAGED"


def test_a_clip_of_another_version_is_not_called_changed(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY)
    name = spool.put(clip())
    fields = msgspec.msgpack.decode(encode(clip()))
    (tmp_path / name).write_bytes(seal_content(name, KEY, msgspec.msgpack.encode(fields[:-3])))
    with pytest.raises(BlockRobotError, match="another version") as caught:
        spool.get(name)
    assert caught.value.code == "SPOOL_DAMAGED"


def refusal(spool: Spool, name: str) -> str:
    with pytest.raises(BlockRobotError) as caught:
        spool.get(name)
    return caught.value.code


def test_a_full_spool_says_so_and_keeps_what_it_has(tmp_path: Path) -> None:
    spool = Spool(tmp_path, KEY, max_bytes=3_000)
    kept = [spool.put(clip(1)), spool.put(clip(2))]
    with pytest.raises(BlockRobotError, match=r"^SPOOL_FULL:"):
        spool.put(clip(3, size_bytes=2_000))
    assert sorted(path.name for path in tmp_path.iterdir()) == kept
    spool.remove(kept[0])
    assert spool.put(clip(4)) in spool.names()


def test_a_full_disk_leaves_no_half_of_a_clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spool = Spool(tmp_path, KEY)

    def no_space(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(BlockRobotError) as caught:
        spool.put(clip())
    monkeypatch.undo()
    assert caught.value.code == "SPOOL_FULL"
    assert list(tmp_path.iterdir()) == []
    assert Spool(tmp_path, KEY).names() == []


def test_a_half_written_clip_is_swept_away_and_a_strangers_file_left_alone(tmp_path: Path) -> None:
    (tmp_path / ".tmp-000000000009.clip").write_bytes(b"half")
    spool = Spool(tmp_path, KEY)
    assert spool.names() == []
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "notes.clip").write_bytes(b"mine")
    spool = Spool(tmp_path, KEY)
    name = spool.put(clip())
    assert spool.names() == [name]
    assert (tmp_path / "notes.clip").read_bytes() == b"mine"


def test_a_clip_that_must_not_be_recorded_is_overwritten_before_it_goes(tmp_path: Path) -> None:
    """A second name of the file, as a careless backup would make: nothing is left to read there."""
    spool = Spool(tmp_path / "spool", KEY)
    name = spool.put(clip())
    second = tmp_path / "second"
    os.link(tmp_path / "spool" / name, second)
    size = second.stat().st_size
    spool.destroy(name)
    assert second.read_bytes() == bytes(size)
    assert (spool.names(), spool.size_bytes, list((tmp_path / "spool").iterdir())) == ([], 0, [])
    spool.destroy(name)


@pytest.mark.parametrize("step", range(6))
def test_a_robot_killed_while_it_destroys_a_clip_works_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    """Killed before each step in turn: the clip is there whole, or it is none, and nothing of it is left."""
    spool = Spool(tmp_path, KEY)
    other, name = spool.put(clip(1)), spool.put(clip(2))
    left = step

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal left
            left -= 1
            if left < 0:
                raise KeyboardInterrupt
            return function(*arguments, **named)

        return call

    with monkeypatch.context() as patched:
        for owner, step_name in ((os, "fsync"), (Path, "unlink"), (Path, "replace"), (Path, "open")):
            patched.setattr(owner, step_name, counted(getattr(owner, step_name)))
        with contextlib.suppress(KeyboardInterrupt):
            spool.destroy(name)
    again = Spool(tmp_path, KEY)
    assert again.names() in ([other], [other, name])
    assert step == 0 or again.names() == [other], "it lost its name first"
    assert {again.get(left_name).upload.record_id for left_name in again.names()} >= {clip(1).upload.record_id}
    assert sorted(path.name for path in tmp_path.iterdir()) == again.names()


def test_a_destroyed_clip_does_not_come_back_with_a_power_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is synced before the content goes: a name that came back would be that of zeros."""
    spool = Spool(tmp_path, KEY)
    name = spool.put(clip())
    synced: list[tuple[bool, list[str]]] = []
    fsync = os.fsync

    def note(descriptor: int) -> None:
        synced.append((stat.S_ISDIR(os.fstat(descriptor).st_mode), sorted(path.name for path in tmp_path.iterdir())))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    spool.destroy(name)
    doomed = [".tmp-" + name]
    assert synced == [(True, doomed), (False, doomed), (True, [])]
