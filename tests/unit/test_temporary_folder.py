"""Where the tests' own files go."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from tests.temporary_folder import find_temporary_folder


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("TMPDIR", raising=False)
    monkeypatch.setattr("tests.temporary_folder.ROOM_MIN_BYTES", 2048)
    return tmp_path


def meminfo(folder: Path, text: str) -> Path:
    path = folder / "meminfo"
    path.write_text(text)
    return path


def test_they_are_in_memory_where_there_is_room(memory: Path) -> None:
    assert find_temporary_folder(memory, meminfo(memory, "MemTotal: 9 kB\nMemAvailable: 2 kB\n")) == memory


@pytest.mark.parametrize("text", ["MemAvailable: 1 kB\n", "MemTotal: 9 kB\n", "MemAvailable: many kB\n"])
def test_they_are_on_disk_where_memory_is_short_or_unknown(memory: Path, text: str) -> None:
    assert find_temporary_folder(memory, meminfo(memory, text)) == Path(tempfile.gettempdir())


def test_they_are_on_disk_where_there_is_no_such_folder(memory: Path) -> None:
    info = meminfo(memory, "MemAvailable: 2 kB\n")
    assert find_temporary_folder(memory / "none", info) == Path(tempfile.gettempdir())
    assert find_temporary_folder(memory, memory / "none") == Path(tempfile.gettempdir())


def test_who_names_a_place_is_given_it(memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", "elsewhere")
    assert find_temporary_folder(memory, meminfo(memory, "MemAvailable: 2 kB\n")) == Path(tempfile.gettempdir())
