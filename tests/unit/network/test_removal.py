"""Making and removing a local network touches nothing that is not its own, whatever folder it is told to use."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.main import main
from network.cluster import Cluster
from network.provisioning.network_files import HALF_DONE
from network.provisioning.network_layout import create_network
from network.provisioning.network_removal import MAKING_MARK, remove_abandoned, remove_network
from node.custody.blobs.blob_names import BlobNames
from node.custody.blobs.blob_store import OWNER_NAME
from node.custody.blobs.folder_blobs import FolderBlobs
from tests.world.cuts import is_killed_after


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with something in it that nobody can bring back."""
    folder = tmp_path / "home"
    (folder / "letters").mkdir(parents=True)
    (folder / "letters" / "dear.txt").write_text("dear", encoding="utf-8")
    return folder


def contents(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_folder_that_holds_something_else_is_refused_and_left_as_it_was(home: Path) -> None:
    with pytest.raises(BlockRobotError, match=r"^FOLDER_NOT_EMPTY:"):
        create_network(home, nodes=1, organisations=1, base_port=25_000)
    result = CliRunner().invoke(main, ["up", "--dir", str(home), "--nodes", "1", "--base-port", "25000"])
    assert result.exit_code != 0
    assert "FOLDER_NOT_EMPTY" in result.output
    assert contents(home) == ["letters", "letters/dear.txt"]
    assert contents(home.parent) == ["home", "home/letters", "home/letters/dear.txt"]


def test_a_network_that_cannot_be_made_leaves_nothing_and_what_else_lies_in_its_folder_stays(tmp_path: Path) -> None:
    place = tmp_path / "network"
    with pytest.raises(BlockRobotError):
        create_network(place, nodes=2, base_port=25_000, store="neither")
    assert contents(tmp_path) == []
    create_network(place, nodes=1, organisations=1, base_port=25_000)
    (place / "thesis.tex").write_text("words", encoding="utf-8")
    remove_network(place)
    assert contents(place) == ["thesis.tex"]


def test_what_custodians_and_new_nodes_leave_goes_with_their_network(tmp_path: Path) -> None:
    place = tmp_path / "network"
    create_network(place, nodes=1, organisations=1, base_port=25_000)
    node, unfinished = place / "nodes" / "node-1", ".unfinished-" + "a" * 16
    blobs = FolderBlobs(node / "clips")
    names = BlobNames(bytes(32))

    async def fill() -> None:
        async with blobs:
            await blobs.put(OWNER_NAME, b"me")
            await blobs.put(names.name(bytes(16), bytes(8)), b"a picture")

    asyncio.run(fill())
    (blob,) = node.glob("clips/*/*/*")
    left = [blob.with_name(unfinished), node / "clips" / unfinished, node / unfinished, node / "node.toml.moving"]
    left += [node / name for name in ("node.toml.copying", "node.csr", "node-entry.draft.json")]
    cut_off = place / "nodes" / f".anew.{HALF_DONE}"  # a restore
    left += [cut_off / "owner.lock", cut_off / "anew" / "node.toml"]
    for custody in ("custody", "custody.moved", "custody.moving"):
        left += [node / custody / name for name in ("clips.json", "custody.sqlite3", "custody.sqlite3-wal", unfinished)]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    remove_network(place)
    assert contents(tmp_path) == []


def test_a_network_may_be_made_in_an_empty_folder_and_is_removed_with_it(tmp_path: Path) -> None:
    place = tmp_path / "network"
    place.mkdir()
    create_network(place, nodes=2, base_port=25_000)
    assert {path.name for path in place.iterdir()} == {"genesis.json", "nodes", "organisations"}
    remove_network(place)
    assert contents(tmp_path) == []


def test_a_folder_without_a_network_and_one_whose_parts_are_links_are_not_touched(home: Path, tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match=r"^DATA_DIRECTORY_INVALID:"):
        remove_network(home)
    place = tmp_path / "network"
    create_network(place, nodes=1, organisations=1, base_port=25_000)
    (place / "nodes").rename(tmp_path / "elsewhere")
    (place / "nodes").symlink_to(home, target_is_directory=True)
    with pytest.raises(BlockRobotError, match=r"^DATA_DIRECTORY_INVALID:"):
        remove_network(place)
    assert contents(home) == ["letters", "letters/dear.txt"]


def test_a_new_network_that_does_not_start_is_removed_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "network"

    async def never_ready(self: Cluster) -> None:
        (self.folder / "notes.txt").write_text("mine", encoding="utf-8")
        raise BlockRobotError("PORT_IN_USE", "Another program already listens on 127.0.0.1:25000.")

    monkeypatch.setattr(Cluster, "start_all", lambda self: self.names)
    monkeypatch.setattr(Cluster, "wait_ready", never_ready)
    result = CliRunner().invoke(main, ["up", "--dir", str(place), "--nodes", "1", "--base-port", "25000"])
    assert "PORT_IN_USE" in result.output
    assert contents(place) == ["notes.txt"]


def test_a_new_network_that_did_not_start_says_the_last_lines_of_the_logs_that_go_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "network"

    def leave_logs(self: Cluster) -> list[str]:
        for name in self.names:
            lines = [f'{{"event": "line {number} of {name}"}}' for number in range(9)]
            self.config(name).log_path.write_text("\n".join(lines), encoding="utf-8")
        return self.names

    monkeypatch.setattr(Cluster, "start_all", leave_logs)
    monkeypatch.setattr(Cluster, "is_running", lambda _self, name: name != "node-2")
    monkeypatch.setattr(Cluster, "_answers_ready", lambda *_rest, **_named: asyncio.sleep(0, result=True))
    monkeypatch.setattr(Cluster, "stop_all", lambda _self: [])
    said = CliRunner().invoke(main, ["up", "--dir", str(place), "--nodes", "2", "--base-port", "25000"])
    assert "Node node-2 stopped" in said.stderr
    assert [number for number in range(9) if f"line {number} of node-2" in said.stderr] == [4, 5, 6, 7, 8]
    assert "of node-1" not in said.stderr
    assert "CLUSTER_FIRST_START_FAILED" in said.stderr
    assert "blockrobot logs" not in said.stderr
    assert not place.exists()


@pytest.mark.parametrize("mine", ["thesis.tex", "nodes/thesis.tex", "nodes/node-1/ledger/old.mdb", "organisations/x/a"])
def test_beginning_anew_deletes_nothing_where_something_else_lies_among_a_network(
    tmp_path: Path, mine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, stopped = tmp_path / "network", list[str]()
    create_network(place, nodes=1, organisations=1, base_port=25_000)
    (place / mine).parent.mkdir(parents=True, exist_ok=True)
    (place / mine).write_text("words", encoding="utf-8")
    before = contents(place)
    monkeypatch.setattr(Cluster, "stop_all", lambda self: stopped.extend(self.names))
    result = CliRunner().invoke(main, ["up", "--ephemeral", "--dir", str(place), "--nodes", "1", "--json"])
    assert json.loads(result.stdout)["error"]["code"] == "FOLDER_NOT_EMPTY"
    assert str(place / mine) in json.loads(result.stdout)["error"]["detail"]
    assert (contents(place), stopped) == (before, [])


def test_what_lies_among_the_files_of_a_network_that_is_removed_stays(home: Path, tmp_path: Path) -> None:
    place = tmp_path / "network"
    create_network(place, nodes=1, organisations=1, base_port=25_000)
    (place / "nodes" / "node-1" / "mine.txt").write_text("mine", encoding="utf-8")
    (place / "nodes" / "node-1" / "custody").symlink_to(home, target_is_directory=True)
    remove_network(place)
    assert contents(place) == ["nodes", "nodes/node-1", "nodes/node-1/custody", "nodes/node-1/mine.txt"]
    assert contents(home) == ["letters", "letters/dear.txt"]


HALF_MADE = """
import signal, sys
from pathlib import Path
from network.provisioning import network_layout as layout

write = layout._write_network

def write_and_wait(making, *rest, **named):
    write(making, *rest, **named)
    print(making.name, flush=True)
    signal.pause()

layout._write_network = write_and_wait
layout.create_network(Path(sys.argv[1]), nodes=1, organisations=1, base_port=25_000)
"""


def test_what_a_killed_maker_left_is_removed_by_the_next_of_the_same_name_and_not_before_it_is_dead(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-c", HALF_MADE, str(tmp_path / "network")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as maker:
        assert maker.stdout is not None
        making = tmp_path / maker.stdout.readline().strip()
        assert (making / "genesis.json").is_file()
        shutil.copytree(making, tmp_path / "copy")
        create_network(tmp_path / "network", nodes=1, organisations=1, base_port=25_000)
        remove_network(tmp_path / "network")
        assert (making / "nodes").is_dir(), "its maker lives"
        os.kill(maker.pid, signal.SIGKILL)
    create_network(tmp_path / "other", nodes=1, organisations=1, base_port=25_000)
    assert making.exists(), "it was made for another folder"
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=25_000)
    assert {path.name for path in tmp_path.iterdir()} == {"copy", "network", "other"}
    assert not (tmp_path / "network" / MAKING_MARK).exists()


def test_a_second_cut_while_that_is_removed_leaves_no_keys_for_good(tmp_path: Path) -> None:
    made, half = tmp_path / "made", tmp_path / ".network.half_one"
    create_network(made, nodes=1, organisations=1, base_port=25_000)
    (made / MAKING_MARK).write_bytes(b"BlockRobot makes a network here.\n")

    def remove_another() -> None:
        shutil.copytree(made, half)
        remove_abandoned(tmp_path / "network")

    removals = 1
    while is_killed_after(removals, remove_another):
        remove_abandoned(tmp_path / "network")
        assert contents(half) == []
        shutil.rmtree(half, ignore_errors=True)
        removals += 1
    assert removals - 1 > len(list(made.rglob("*.key")))


def test_what_only_looks_left_behind_stays(tmp_path: Path, home: Path) -> None:
    """Names of eight characters are anybody's, and a mark may be copied to where something else lies."""
    text = b"BlockRobot makes a network here.\n"
    unmarked, otherwise, mixed, linked, inside = (
        tmp_path / f".network.{name}" for name in ("unmarked", "a_letter", "mixed_up", "linked_x", "inside_1")
    )
    for folder in (unmarked, otherwise, mixed, linked):
        (folder / "nodes").mkdir(parents=True)
    (otherwise / MAKING_MARK).write_bytes(b"")
    (mixed / MAKING_MARK).write_bytes(text)
    (mixed / "thesis.tex").write_text("words", encoding="utf-8")
    (linked / MAKING_MARK).write_bytes(text)
    (linked / "organisations").symlink_to(home, target_is_directory=True)
    (home / MAKING_MARK).write_bytes(text)
    (tmp_path / ".network.homelink").symlink_to(home, target_is_directory=True)
    (inside / "nodes").mkdir(parents=True)
    (inside / MAKING_MARK).write_bytes(text)
    (inside / "nodes" / "thesis.tex").write_text("words", encoding="utf-8")
    before = contents(home)
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=25_000)
    assert contents(unmarked) == ["nodes"]
    assert contents(otherwise) == [MAKING_MARK, "nodes"]
    assert contents(mixed) == [MAKING_MARK, "nodes", "thesis.tex"]
    assert contents(inside) == [MAKING_MARK, "nodes", "nodes/thesis.tex"]
    assert contents(linked)[:2] == [MAKING_MARK, "nodes"]
    assert contents(home) == before
