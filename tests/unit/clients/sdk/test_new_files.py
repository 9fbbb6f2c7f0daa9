"""A file that a user names is written whole, for them alone, never over another and never through a link."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from clients.sdk.new_files import (
    new_file,
    open_to_append,
    read_given_file,
    read_given_text,
    write_new_file,
    write_private,
)
from consensus.errors import BlockRobotError


@pytest.fixture(autouse=True)
def _usual_mask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


@pytest.mark.parametrize(("private", "expected"), [(True, 0o600), (False, 0o644)])
def test_a_new_file_is_for_its_owner_unless_it_is_public(tmp_path: Path, private: bool, expected: int) -> None:
    write_new_file(tmp_path / "out", "text", private=private)
    assert ((tmp_path / "out").read_text(), mode(tmp_path / "out")) == ("text", expected)
    assert names(tmp_path) == ["out"]


def test_what_is_there_stays_and_no_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "mine").write_bytes(b"mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    (tmp_path / "dangling").symlink_to(tmp_path / "target")
    for name in ("mine", "link", "dangling"):
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            write_new_file(tmp_path / name, b"new")
    for name in ("link", "dangling"):
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            write_new_file(tmp_path / name, b"new", replace=True)
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            write_private(tmp_path / name, b"new")
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            open_to_append(tmp_path / name)
    assert (tmp_path / "mine").read_bytes() == b"mine"
    assert names(tmp_path) == ["dangling", "link", "mine"]


def test_a_file_that_appears_meanwhile_stays(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="FILE_EXISTS"), new_file(tmp_path / "out"):
        (tmp_path / "out").write_bytes(b"theirs")
    assert (tmp_path / "out").read_bytes() == b"theirs"
    assert names(tmp_path) == ["out"]


def test_nothing_is_left_of_what_was_not_finished(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no card"), new_file(tmp_path / "out"):
        raise RuntimeError("no card")
    with pytest.raises(BlockRobotError, match="FILE_UNUSABLE"):
        write_new_file(tmp_path / "no" / "out", b"new")
    assert names(tmp_path) == []


def test_what_is_replaced_is_for_its_owner_afterwards(tmp_path: Path) -> None:
    for write in (write_private, lambda path, data: write_new_file(path, data, replace=True)):
        (tmp_path / "out").write_bytes(b"old, and longer")
        (tmp_path / "out").chmod(0o644)
        write(tmp_path / "out", b"new")
        assert ((tmp_path / "out").read_bytes(), mode(tmp_path / "out")) == (b"new", 0o600)


def test_what_is_added_to_is_for_its_owner_alone(tmp_path: Path) -> None:
    for text in (b"a", b"b"):
        with open_to_append(tmp_path / "log") as file:
            assert mode(tmp_path / "log") == 0o600
            file.write(text)
        (tmp_path / "log").chmod(0o644)
    with open_to_append(tmp_path / "log") as file:
        assert mode(tmp_path / "log") == 0o600
        file.seek(0)
        assert file.read() == b"ab"


def test_what_somebody_else_laid_there_is_neither_added_to_nor_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "theirs").write_bytes(b"theirs")
    (tmp_path / "linked").hardlink_to(tmp_path / "theirs")
    (tmp_path / "only").write_bytes(b"theirs")
    os.mkfifo(tmp_path / "pipe")
    if os.geteuid() == 0:
        os.chown(tmp_path / "only", 65534, 65534)
    else:  # nobody else can give a file away: then this process is somebody else
        owner = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    (tmp_path / "only").chmod(0o666)
    for name in ("linked", "only", "pipe"):
        for write in (open_to_append, lambda path: write_private(path, b"new")):
            with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
                write(tmp_path / name)
    assert {(tmp_path / name).read_bytes() for name in ("theirs", "only")} == {b"theirs"}
    assert mode(tmp_path / "only") == 0o666


def test_no_more_is_read_than_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "in").write_bytes(b"abc")
    assert read_given_file(tmp_path / "in", 3) == b"abc"
    for path in (tmp_path / "in", Path("/dev/zero")):
        with pytest.raises(BlockRobotError, match="FILE_UNUSABLE"):
            read_given_file(path, 2)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "words.txt").write_bytes("café".encode("latin-1"))
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: .*words\.txt is not a text file in utf-8"):
        read_given_text(tmp_path / "words.txt")
    assert read_given_text(tmp_path / "words.txt", encoding="latin-1") == "café"
