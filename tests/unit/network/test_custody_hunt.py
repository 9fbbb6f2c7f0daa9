"""The hunt for what is left of a record: needles in large files, what may be where, and traces that open nothing."""

from __future__ import annotations

import json
import os
import secrets
import stat
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.main import main
from network.custody import searching
from network.custody.hunt import explain, files_below, place_of
from network.custody.searching import PREFIX_BYTES, Search, spread
from network.custody.traces import Trace, read_traces, trace_plaintext, write_traces
from network.provisioning.network_layout import create_network

KINDS = ("id", "root", "metadata", "leaf", "ciphertext", "wrapped-key", "sealed-key", "erase-key", "plaintext")
PLACES = ("store", "erase-keys", "ledger", "journal", "snapshots", "log", "other")


def test_needles_are_counted_wherever_they_lie_also_across_the_pieces_that_a_file_is_read_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(searching, "CHUNK_BYTES", 1000)
    needles = [secrets.token_bytes(length) for length in (12, 13, 16, 40)]
    alike = [needles[0][:8] + secrets.token_bytes(8), needles[3][:39] + bytes([needles[3][39] ^ 1])]
    content = bytearray(secrets.token_bytes(10_000))
    for number, place in enumerate((0, 990, 1999, 3000, 4985, 9_960)):
        needle = needles[number % 4]
        content[place : place + len(needle)] = needle
    path = tmp_path / "file"
    path.write_bytes(bytes(content))
    found = Search([*needles, *alike]).in_file(path)
    assert found == {needle: bytes(content).count(needle) for needle in needles if needle in content}
    assert sum(found.values()) >= 5
    assert Search(needles).in_bytes(bytes(content)) == found


def test_nothing_is_found_in_empty_short_and_missing_files(tmp_path: Path) -> None:
    search = Search([secrets.token_bytes(16)])
    (tmp_path / "empty").touch()
    (tmp_path / "short").write_bytes(b"short")
    for name in ("empty", "short", "missing"):
        assert not search.in_file(tmp_path / name)
    assert not Search([]).in_bytes(bytes(100))
    with pytest.raises(ValueError, match="twelve"):
        Search([b"too short"])


def test_pieces_come_from_start_to_end_and_none_of_them_is_background(tmp_path: Path) -> None:
    content = secrets.token_bytes(1000)
    pieces = spread(content, 4)
    assert len(pieces) == 4
    assert (pieces[0], pieces[-1]) == (content[:12], content[-12:])
    assert spread(bytes(1000), 4) == []
    assert spread(b"short", 4) == []


@pytest.mark.parametrize("what", KINDS)
def test_of_an_erased_record_only_the_chains_word_and_a_mark_may_be_left(what: str) -> None:
    allowed = {place for place in PLACES if explain(place, what, is_gone=True)}
    chain = {"ledger", "journal", "snapshots"}
    expected = {"id": chain | {"store", "log"}, "root": chain, "metadata": chain}
    assert allowed == expected.get(what, set())


@pytest.mark.parametrize("what", ["sealed-key", "plaintext"])
def test_bare_keys_and_pictures_may_never_be_anywhere(what: str) -> None:
    assert not [place for place in PLACES for gone in (False, True) if explain(place, what, is_gone=gone)]


def test_an_erase_key_may_only_be_in_its_file_and_a_ciphertext_only_in_the_store() -> None:
    assert [place for place in PLACES if explain(place, "erase-key", is_gone=False)] == ["erase-keys"]
    assert [place for place in PLACES if explain(place, "ciphertext", is_gone=False)] == ["store"]


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("nodes/node-1/custody/custody.sqlite3-wal", "store"),
        ("nodes/node-1/erase-keys/erase-keys", "erase-keys"),
        ("nodes/node-1/ledger/data.mdb", "ledger"),
        ("nodes/node-1/journal/votes.journal", "journal"),
        ("nodes/node-1/snapshots.fetched/x/chunk", "snapshots"),
        ("nodes/node-1/node.log", "log"),
        ("nodes/node-1/custody.backup/custody.sqlite3", "other"),
        ("organisations/hospital/admin.key", "other"),
    ],
)
def test_a_place_is_known_by_its_path(path: str, kind: str) -> None:
    assert place_of(Path(path)) == kind


def test_traces_are_for_their_owner_only_and_hold_no_whole_key(tmp_path: Path) -> None:
    key, trace = secrets.token_bytes(32), Trace(secrets.token_bytes(16), "active")
    trace.add("erase-key", key[:PREFIX_BYTES])
    trace.add("id", trace.record_id)
    path = tmp_path / "before.json"
    write_traces(path, [trace])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert (
        max(len(piece) for piece in json.loads(path.read_text())["records"][trace.record_id.hex()]["erase-key"]) == 24
    )
    (again,) = read_traces(path)
    assert (again.record_id, again.pieces) == (trace.record_id, trace.pieces)
    with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
        write_traces(path, [trace])
    assert list(tmp_path.iterdir()) == [path]


def test_traces_that_were_cut_off_while_they_were_written_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_descriptor: int) -> None:
        raise OSError(28, "no space left")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="no space"):
        write_traces(tmp_path / "before.json", [Trace(secrets.token_bytes(16))])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{}", b'{"format": 2, "records": {}}', b'{"format":1,"records":{"x":{}}}'])
def test_a_file_that_is_none_of_traces_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE:"):
        read_traces(tmp_path / "x")


def test_a_picture_is_looked_for_by_its_file_and_by_its_pixels_in_either_order_of_bytes(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).integers(0, 65536, (40, 40), dtype=np.uint16)
    path = tmp_path / "frame.png"
    assert cv2.imwrite(str(path), pixels)
    trace = Trace(bytes(16))
    trace_plaintext(trace, path)
    search = Search(trace.pieces["plaintext"])
    for content in (path.read_bytes(), pixels.tobytes(), pixels.byteswap().tobytes()):
        assert len(search.in_bytes(b"before" + content + b"after")) >= 8


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("custody-hunt") / "network"
    create_network(folder, nodes=2, organisations=1, base_port=46_510)
    return folder


@pytest.mark.parametrize(
    ("arguments", "exit_code"),
    [((), 2), (("xyz",), 2), (("ab" * 15,), 2), (("ab" * 16, "cd" * 16, "--plaintext", __file__), 2)],
)
def test_wrong_usage_is_said_to_be(folder: Path, arguments: tuple[str, ...], exit_code: int) -> None:
    result = CliRunner().invoke(main, ["custody", "hunt", *arguments, "--dir", str(folder)])
    assert result.exit_code == exit_code, result.output


def test_traces_of_other_records_are_refused(folder: Path, tmp_path: Path) -> None:
    write_traces(tmp_path / "x.json", [Trace(secrets.token_bytes(16))])
    arguments = ["custody", "hunt", "ab" * 16, "--trace", str(tmp_path / "x.json"), "--dir", str(folder), "--json"]
    result = CliRunner().invoke(main, arguments)
    assert (result.exit_code, json.loads(result.stdout)["error"]["code"]) == (1, "FILE_UNUSABLE")


def _hunt_for(
    monkeypatch: pytest.MonkeyPatch, folder: Path, trace: Trace, *arguments: str
) -> tuple[int, dict[str, Any]]:
    """Hunt for what a chain and its custodians are said to know of a record."""

    def know(_cluster: object, _ids: object, known: list[Trace]) -> list[Trace]:
        for each in known:
            trace.pieces |= each.pieces
        return [trace]

    monkeypatch.setattr("network.cli.custody.custody_hunt_commands.gather", know)
    told = ["custody", "hunt", trace.record_id.hex(), *arguments, "--dir", str(folder)]
    said = CliRunner().invoke(main, told)
    assert ("Nothing was found" in said.stdout) == (said.exit_code == 0), said.output
    result = CliRunner().invoke(main, [*told, "--json"])
    assert result.exit_code == said.exit_code
    return result.exit_code, json.loads(result.stdout)


@pytest.mark.parametrize("status", ["erasing", "erased", "expired"])
def test_a_record_that_is_gone_is_not_called_clean_without_its_trace(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: str
) -> None:
    trace, path = Trace(secrets.token_bytes(16), status), tmp_path / "mistyped.json"
    trace.add("id", trace.record_id)
    trace.add("root", secrets.token_bytes(32))
    exit_code, report = _hunt_for(monkeypatch, folder, trace)
    assert (exit_code, report["ok"], report["not_compared"]) == (1, False, [trace.record_id.hex()])
    assert not report["found"]
    exit_code, report = _hunt_for(monkeypatch, folder, trace, "--trace", str(path), "--plaintext", __file__)
    assert (exit_code, report["error"]["code"]) == (1, "FILE_UNUSABLE")
    assert "mistyped.json does not exist" in report["error"]["detail"]
    assert not path.exists(), "a trace that finds nothing is not written"
    write_traces(path, [trace])
    assert _hunt_for(monkeypatch, folder, trace, "--trace", str(path))[1]["not_compared"] == [trace.record_id.hex()]


def test_a_trace_of_before_a_picture_and_a_record_that_is_kept_are_compared(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, picture = tmp_path / "before.json", tmp_path / "picture"
    kept = Trace(secrets.token_bytes(16), "active")
    kept.add("id", kept.record_id)
    kept.add("ciphertext", secrets.token_bytes(100), 4)
    assert _hunt_for(monkeypatch, folder, kept, "--trace", str(path))[0] == 0
    assert path.exists()
    gone = Trace(kept.record_id, "erased")
    assert _hunt_for(monkeypatch, folder, gone, "--trace", str(path))[0] == 0
    picture.write_bytes(secrets.token_bytes(1000))
    gone = Trace(secrets.token_bytes(16), "erased")
    exit_code, report = _hunt_for(monkeypatch, folder, gone, "--plaintext", str(picture))
    assert (exit_code, report["not_compared"]) == (0, [])


def test_a_folder_that_lies_elsewhere_by_a_link_is_searched_once_and_a_loop_ends(tmp_path: Path) -> None:
    """Custody on another disk is custody."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "custody.sqlite3").write_bytes(b"needle")
    node = tmp_path / "net" / "nodes" / "node-1"
    node.mkdir(parents=True)
    (node / "custody").symlink_to(tmp_path / "disk")
    (node / "custody" / "round").symlink_to(tmp_path / "net")
    (node / "node.log").symlink_to(tmp_path / "disk" / "custody.sqlite3")
    (node / "gone").symlink_to(tmp_path / "nowhere")
    unread: list[str] = []
    found = list(files_below(tmp_path / "net", unread))
    assert {path.name for path in found} == {"custody.sqlite3", "node.log"}
    assert [place_of(path.relative_to(tmp_path / "net")) for path in found if path.name == "custody.sqlite3"] == [
        "store"
    ]
    assert len(unread) == 1
    assert "gone" in unread[0]


def test_a_folder_that_cannot_be_read_is_said_to_be_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "closed").mkdir()
    scandir = os.scandir

    def refuse(place: str) -> object:
        if str(place).endswith("closed"):
            raise PermissionError(13, "Permission denied", str(place))
        return scandir(place)

    monkeypatch.setattr("os.scandir", refuse)
    unread: list[str] = []
    assert list(files_below(tmp_path, unread)) == []
    assert unread == [f"{tmp_path / 'closed'}: Permission denied"]
