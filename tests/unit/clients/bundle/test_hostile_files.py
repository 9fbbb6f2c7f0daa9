"""Files that a stranger sends: bombs, ways out, doubles, links, lies about sizes, half files. Each is refused, at once."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from clients.bundle import layout
from clients.bundle.checks.bundle_check import Verdict, verify_bundle
from clients.bundle.container import ENTRIES_MAX_COUNT, BundleReader, BundleWriter, is_name
from clients.bundle.writing import write_bundle
from consensus.errors import BlockRobotError
from tests.unit.clients.bundle.conftest import Made
from tests.unit.clients.bundle.repacking import Files, judge, pack

TIMELY_S = 20
NO_BUNDLES = [b"", b"P", b"PK", b"PK\x03\x04", b"PK\x05\x06" + bytes(18), b"%PDF-1.7\n", bytes(1000)]
WAYS_OUT = ["../x", "a/../../x", "/etc/passwd", "a//b", "a/", "./a", "a/./b", "C:x", "a\\b", "a\0b"]
NO_NAMES = ["A", "ä", "", " ", "-a", "a" * 97]


def refused(tmp_path: Path, content: bytes) -> BlockRobotError:
    error = judge(tmp_path / "hostile.zip", content, None)
    assert isinstance(error, BlockRobotError)
    return error


def zipped(write: Callable[[zipfile.ZipFile], None], how: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as packed:
        write(packed)
    return buffer.getvalue()


def lying(name: bytes, size: int, content: bytes, *, method: int = 0, flags: int = 0) -> bytes:
    """One local entry with whatever sizes."""
    head = (b"PK\x03\x04", 10, flags, method, 0, 0x21, 0, size, size, len(name), 0)
    return struct.pack("<4s5H3I2H", *head) + name + content


def replaced(files: Files, **changes: bytes) -> bytes:
    return pack(files | {name.replace("__", "."): content for name, content in changes.items()})


@pytest.mark.parametrize("content", NO_BUNDLES)
def test_what_is_no_bundle_is_refused(tmp_path: Path, content: bytes) -> None:
    assert refused(tmp_path, content).code == "BUNDLE_INVALID"


@pytest.mark.timeout(TIMELY_S)
def test_a_bomb_is_never_unpacked(tmp_path: Path) -> None:
    """A gigabyte of zeros in a megabyte, in a chain of names: the first header tells, and nothing is unpacked."""
    zeros = bytes(1 << 20)

    def write(packed: zipfile.ZipFile) -> None:
        with packed.open("manifest.json", "w") as entry:
            for _ in range(256):
                entry.write(zeros)

    content = zipped(write, zipfile.ZIP_DEFLATED)
    assert len(content) < 1 << 20
    assert "packed anew" in refused(tmp_path, content).detail


@pytest.mark.parametrize("size", [(1 << 32) - 1, 1 << 31, 10_000_000])
def test_a_size_that_is_a_lie_is_not_believed(tmp_path: Path, size: int) -> None:
    assert "breaks off" in refused(tmp_path, lying(b"manifest.json", size, b"{}")).detail


def test_a_sparse_file_of_many_gigabytes_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "sparse.zip"
    with path.open("wb") as file:
        file.truncate(5 << 30)
    with pytest.raises(BlockRobotError, match="4 GiB"):
        verify_bundle(path)


@pytest.mark.parametrize("name", WAYS_OUT + NO_NAMES)
def test_a_name_that_leads_out_is_no_name(tmp_path: Path, name: str) -> None:
    assert not is_name(name)
    assert refused(tmp_path, lying(name.encode(), 0, b"")).code == "BUNDLE_INVALID"


def test_two_entries_of_one_name_are_refused(made: Made, tmp_path: Path) -> None:
    """Two programs would show two different files."""
    entry = lying(b"a", 0, b"")
    assert "two entries" in refused(tmp_path, entry + entry).detail


def test_a_link_is_refused(made: Made, tmp_path: Path) -> None:
    content = bytearray(made.path.read_bytes())
    place = content.index(b"PK\x01\x02")
    struct.pack_into("<I", content, place + 38, 0o120777 << 16)
    assert "directory" in refused(tmp_path, bytes(content)).detail


@pytest.mark.parametrize("flags", [1, 8, 0x800])
def test_flags_of_secret_or_late_sizes_are_refused(tmp_path: Path, flags: int) -> None:
    assert "packed anew" in refused(tmp_path, lying(b"a", 0, b"", flags=flags)).detail


def test_a_bundle_that_another_program_packed_is_told_apart_from_a_damaged_one(made: Made, tmp_path: Path) -> None:
    files = made.files
    content = zipped(lambda packed: [packed.writestr(name, data) for name, data in files.items()] and None)
    assert "packed anew" in refused(tmp_path, content).detail


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: b"MZ" + content,
        lambda content: content + b"\0",
        lambda content: content[:-2] + b"\x05\x00hello",
        lambda content: content.replace(b"PK\x01\x02", b"hidden between PK\x01\x02", 1),
        lambda content: content.replace(b"PK\x03\x04", b"xPK\x03\x04"),
    ],
    ids=["before", "after", "comment", "between", "between entries"],
)
def test_nothing_hides_before_between_or_behind(made: Made, tmp_path: Path, spoil: Callable[[bytes], bytes]) -> None:
    assert refused(tmp_path, spoil(made.path.read_bytes())).code == "BUNDLE_INVALID"


def test_half_a_file_is_refused_wherever_it_breaks_off(made: Made, tmp_path: Path) -> None:
    content = made.path.read_bytes()
    for length in [*range(0, len(content), 1_999), len(content) - 1]:
        assert refused(tmp_path, content[:length]).code == "BUNDLE_INVALID"


def test_a_file_too_many_and_a_file_too_few_are_refused(made: Made, tmp_path: Path) -> None:
    for name in made.files:
        files = {key: content for key, content in made.files.items() if key != name}
        assert refused(tmp_path, pack(files)).code.startswith("BUNDLE_"), name
        assert refused(tmp_path, made.forge(files) if name not in {"manifest.json", "signatures.json"} else b"")
    assert refused(tmp_path, pack(made.files | {"more.txt": b"read me"})).code == "BUNDLE_INVALID"


@pytest.mark.parametrize(
    "name", ["more.txt", "pictures/0001/00009-00.png", "proofs/state-0009.json", "committed/x.bin"]
)
def test_a_file_that_its_maker_adds_and_lists_follows_from_nothing(made: Made, tmp_path: Path, name: str) -> None:
    files = made.files
    first = {name: b"look at me"}
    for together in (first | files, files | first):
        assert refused(tmp_path, made.forge(together)).code.startswith("BUNDLE_")


def test_files_in_another_order_are_refused(made: Made, tmp_path: Path) -> None:
    files = made.files
    names = list(files)
    names[3], names[4] = names[4], names[3]
    assert "order" in refused(tmp_path, made.forge({name: files[name] for name in names})).detail


@pytest.mark.timeout(TIMELY_S)
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"null",
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"format": 1e999}',
        b'{"format": "' + b"a" * 1_000_000 + b'"}',
        b'{"format": "\xff"}',
        b'{"version": ' + b"9" * 10_000 + b"}",
    ],
    ids=["empty", "null", "deep list", "deep object", "huge number", "long text", "no text", "long number"],
)
@pytest.mark.parametrize("name", ["manifest__json", "proofs/chain__json", "signatures__json"])
def test_json_that_is_none_or_never_ends_is_refused(made: Made, tmp_path: Path, name: str, content: bytes) -> None:
    files = made.files | {name.replace("__", "."): content}
    packed = pack(files) if name != "proofs/chain__json" else made.forge(files)
    assert refused(tmp_path, packed).code.startswith("BUNDLE_")


@pytest.mark.timeout(TIMELY_S)
def test_json_of_more_than_a_document_may_have_is_not_even_read(made: Made, tmp_path: Path) -> None:
    large = b" " * (layout.DOCUMENT_MAX_BYTES + 1)
    assert "larger than" in refused(tmp_path, replaced(made.files, manifest__json=large)).detail


@pytest.mark.parametrize("old", [b'"format":', b"{\n", b'"blockrobot-export"'])
def test_json_in_another_form_is_refused(made: Made, tmp_path: Path, old: bytes) -> None:
    """A second field of the same name, a space, an escape: two readers could read two things."""
    twice, escaped = b'"format": "x",\n "format":', b'"blockrobot\\u002dexport"'
    new = {b'"format":': twice, b"{\n": b"{ \n", b'"blockrobot-export"': escaped}
    manifest = made.files["manifest.json"].replace(old, new[old], 1)
    assert "changed" in refused(tmp_path, replaced(made.files, manifest__json=manifest)).detail


def test_more_proofs_than_anybody_holds_in_memory_are_neither_read_nor_written(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "PROOFS_MAX_BYTES", 10_000)
    assert "proofs are larger" in refused(tmp_path, made.path.read_bytes()).detail
    with pytest.raises(BlockRobotError, match=r"^EXPORT_TOO_LARGE:"):
        write_bundle(tmp_path / "mine.zip", made.contents)


def test_a_file_with_more_entries_than_any_bundle_is_refused(tmp_path: Path) -> None:
    entries = b"".join(lying(b"a%d" % number, 0, b"") for number in range(ENTRIES_MAX_COUNT + 1))
    assert "more than" in refused(tmp_path, entries).detail


@pytest.mark.timeout(TIMELY_S)
def test_a_folder_a_pipe_and_a_device_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(BlockRobotError, match="no file"):
            verify_bundle(path)


def test_what_a_file_says_cannot_move_the_terminal(made: Made, tmp_path: Path) -> None:
    """An unknown field is named in the refusal: without what would clear the screen."""
    manifest = made.files["manifest.json"].replace(b'"format"', b'"\\u001b[2J"', 1)
    error = refused(tmp_path, replaced(made.files, manifest__json=manifest))
    assert "\x1b" not in error.detail
    assert error.detail.isprintable()


def test_the_file_is_not_trusted_to_stay_as_it_was(made: Made) -> None:
    """Somebody writes into it while it is read."""
    buffer = io.BytesIO(made.path.read_bytes())
    reader = BundleReader(buffer, len(buffer.getvalue()))
    place = reader.entry("genesis.json").start
    buffer.getbuffer()[place] ^= 1
    with pytest.raises(BlockRobotError, match="changed while it was read"):
        reader.read("genesis.json", 1 << 20)


def test_the_writer_takes_no_name_that_a_reader_refuses_and_no_second_one() -> None:
    writer = BundleWriter(io.BytesIO())
    writer.add("a", b"")
    for name in ("a", "../a", "B"):
        with pytest.raises(BlockRobotError, match="No entry"):
            writer.add(name, b"")


def test_any_unpacking_program_reads_a_bundle(made: Made) -> None:
    with zipfile.ZipFile(made.path) as packed:
        assert packed.testzip() is None
        assert {info.external_attr >> 16 for info in packed.infolist()} == {0o100600}
        assert {name: packed.read(name) for name in packed.namelist()} == made.files


def test_a_sound_file_is_still_sound_here(made: Made, tmp_path: Path) -> None:
    """So that nothing above is refused for a reason of its own."""
    assert isinstance(judge(tmp_path / "x.zip", pack(made.files), None), Verdict)
