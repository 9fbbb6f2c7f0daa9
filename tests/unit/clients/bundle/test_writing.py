"""Writing: whole or not at all, for its owner alone, and never over something that is there."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import signal
import stat
from pathlib import Path

import pytest

from clients.bundle import writing
from clients.bundle.writing import Contents, require_free, write_bundle
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from tests.unit.clients.bundle.conftest import Made


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_only_its_owner_can_read_it(made: Made, tmp_path: Path) -> None:
    write_bundle(tmp_path / "mine.zip", made.contents)
    assert stat.S_IMODE((tmp_path / "mine.zip").stat().st_mode) == 0o600
    assert names(tmp_path) == ["mine.zip"]


def test_what_is_there_is_not_replaced_unasked(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "mine.zip"
    path.write_text("mine")
    with pytest.raises(BlockRobotError) as caught:
        write_bundle(path, made.contents)
    assert (caught.value.code, path.read_text()) == ("FILE_EXISTS", "mine")
    write_bundle(path, made.contents, replace=True)
    assert path.read_bytes() == made.path.read_bytes()
    assert names(tmp_path) == ["mine.zip"]


def test_a_link_and_a_folder_are_never_written_through(made: Made, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "target").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for name in ("folder", "link", "dangling"):
        with pytest.raises(BlockRobotError, match="already"):
            require_free(tmp_path / name, replace=True)
    with pytest.raises(BlockRobotError, match="no folder"):
        require_free(tmp_path / "none" / "mine.zip", replace=False)


def test_what_appears_meanwhile_is_not_replaced(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "mine.zip"

    def appear(_what: str, _done: int, _of: int) -> None:
        path.write_text("somebody else's")

    with pytest.raises(BlockRobotError, match="meanwhile"):
        write_bundle(path, made.contents, heard=appear)
    assert path.read_text() == "somebody else's"
    assert names(tmp_path) == ["mine.zip"]


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "stopped"]
)
def test_a_write_that_ends_early_leaves_nothing(made: Made, tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "mine.zip"
    path.write_text("the one before")

    def fail(what: str, done: int, _of: int) -> None:
        if done == 2:
            raise error

    with pytest.raises(type(error)):
        write_bundle(path, made.contents, replace=True, heard=fail)
    assert path.read_text() == "the one before"
    assert names(tmp_path) == ["mine.zip"]


def sign_nothing(_key: bytes) -> PrivateKey:
    raise AssertionError("it went on to the end")


def write_until_ended(path: Path, contents: Contents, number: int, nameless: int) -> None:
    """In a process of its own: it is ended in the midst of writing."""
    os.O_TMPFILE = nameless
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

    def end(_what: str, done: int, _of: int) -> None:
        if done == 2:
            os.kill(os.getpid(), number)

    write_bundle(path, contents, replace=True, heard=end)


def end_writing(made: Made, path: Path, number: int, nameless: int) -> int | None:
    """Let a process write and be ended; returns its exit code."""
    path.write_text("the one before")
    contents = dataclasses.replace(made.contents, find_key=sign_nothing)
    arguments = (path, contents, number, nameless)
    process = multiprocessing.get_context("spawn").Process(target=write_until_ended, args=arguments)
    process.start()
    process.join()
    assert path.read_text() == "the one before"
    return process.exitcode


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["terminated", "terminal closed"])
def test_a_program_that_is_told_to_end_leaves_nothing(made: Made, tmp_path: Path, number: int) -> None:
    """Also where every file has a name from the beginning."""
    assert end_writing(made, tmp_path / "mine.zip", number, nameless=0) == 128 + number
    assert names(tmp_path) == ["mine.zip"]


def test_a_program_that_is_killed_leaves_nothing_where_a_file_needs_no_name(made: Made, tmp_path: Path) -> None:
    """No handler runs then. Where every file has a name one is left: that is the difference, and the how-to says it."""
    assert end_writing(made, tmp_path / "mine.zip", signal.SIGKILL, os.O_TMPFILE) == -signal.SIGKILL
    assert len(names(tmp_path)) == (1 if knows_nameless_files(tmp_path) else 2)
    before = names(tmp_path)
    end_writing(made, tmp_path / "mine.zip", signal.SIGKILL, nameless=0)
    (left,) = set(names(tmp_path)) - set(before)
    assert left.startswith(".mine.zip.")


def knows_nameless_files(folder: Path) -> bool:
    try:
        os.close(os.open(folder, os.O_RDWR | os.O_TMPFILE))
    except OSError:
        return False
    return True


def test_where_every_file_has_a_name_a_bundle_is_written_as_well(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "O_TMPFILE", 0)
    write_bundle(tmp_path / "mine.zip", made.contents)
    assert (tmp_path / "mine.zip").read_bytes() == made.path.read_bytes()
    assert names(tmp_path) == ["mine.zip"]


def test_what_ends_a_program_is_as_it_was_once_a_bundle_is_written(made: Made, tmp_path: Path) -> None:
    numbers = (signal.SIGTERM, signal.SIGINT)
    before = [signal.SIG_DFL, signal.default_int_handler]
    # Whoever started the tests may have had them ignored.
    outside = [signal.signal(number, handler) for number, handler in zip(numbers, before, strict=True)]
    during = []
    try:
        write_bundle(
            tmp_path / "mine.zip", made.contents, heard=lambda *_: during.extend(map(signal.getsignal, numbers))
        )
        assert [signal.getsignal(number) for number in numbers] == before
        assert during
        assert set(during).isdisjoint(before)
    finally:
        for number, handler in zip(numbers, outside, strict=True):
            signal.signal(number, handler)


def test_a_bundle_that_a_stranger_would_refuse_never_gets_its_name(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever a custodian, a node or a disk did: what is written is read again as anybody reads it."""
    pack = writing.write_entries

    def spoil(file: object, contents: object, heard: object) -> None:
        pack(file, contents, heard)  # type: ignore[arg-type]
        file.seek(500)  # type: ignore[attr-defined]
        file.write(b"?")  # type: ignore[attr-defined]

    monkeypatch.setattr(writing, "write_entries", spoil)
    with pytest.raises(BlockRobotError, match=r"^BUNDLE_INVALID:"):
        write_bundle(tmp_path / "mine.zip", made.contents)
    assert names(tmp_path) == []


def test_frames_that_do_not_lead_to_their_commitment_are_not_written(made: Made, tmp_path: Path) -> None:
    class Wrong:
        def committed(self, name: str, record_id: bytes, index: int) -> bytes:
            return made.contents.source.committed(name, record_id, index) + b"\0"

        def background(self, digest: bytes) -> bytes | None:
            return None

    with pytest.raises(BlockRobotError, match="not what the robot committed to"):
        write_bundle(tmp_path / "mine.zip", dataclasses.replace(made.contents, source=Wrong()))
    assert names(tmp_path) == []
