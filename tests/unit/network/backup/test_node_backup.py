"""A node is backed up, and made anew where nothing of it is left. The backup holds no secret, and loses nothing.

Of a node that runs: `tests/hosts`.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.node import node_run_commands
from network.cli.node.backup_commands import backup, restore
from network.cluster import Cluster
from network.provisioning import node_backup
from network.provisioning.network_layout import create_network
from network.provisioning.node_backup import MANIFEST_FILE, BackupManifest, back_up, read_backup
from node.config import NodeConfig, load_config, load_genesis
from node.custody.erase_keys import ERASE_KEYS_FILE_NAME, EraseKeys
from node.node_process import Node
from node.storage.lmdb_reader import LedgerFile
from tests.cluster.network_under_test import find_base_port
from tests.unit.network.backup.conftest import changed, restored_from
from tests.world.cuts import is_killed_after


def test_a_backup_holds_its_ledger_and_clips_and_no_secret(config: NodeConfig, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    made = back_up(config, out, with_keys=False)
    assert (made.node, made.height, made.has("custody"), made.has("keys")) == ("node-1", 0, True, False)
    assert read_backup(out) == made
    secrets = [path.read_bytes() for path in (config.data_dir / "keys").glob("*.key")]
    secrets += [(config.erase_keys_dir / ERASE_KEYS_FILE_NAME).read_bytes()[512:700]]
    content = b"".join(path.read_bytes() for path in out.rglob("*") if path.is_file())
    assert len(secrets) == 3
    assert not any(secret in content for secret in secrets)
    assert not any("journal" in str(path) or "token" in str(path) for path in out.rglob("*"))
    assert stat.S_IMODE(out.stat().st_mode) == 0o700
    with pytest.raises(BlockRobotError, match=r"^FILE_EXISTS"):
        back_up(config, out, with_keys=False)


def test_older_backups_of_the_same_node_are_deleted_once_the_new_one_is_there(
    config: NodeConfig, tmp_path: Path
) -> None:
    folder = tmp_path / "backups"

    def earlier(name: str, **said: Any) -> Path:
        made = msgspec.structs.replace(back_up(config, folder / name, with_keys=False), **said)
        (folder / name / MANIFEST_FILE).write_bytes(msgspec.json.encode(made))
        return folder / name

    for number in range(3):
        earlier(f"made-{number}", made_at_ms=10 - number)  # by what they say, not by name
    (earlier("with-more", made_at_ms=1) / "mine.txt").write_text("no backup wrote this")
    (earlier("incomplete", made_at_ms=1) / "node" / "genesis.json").unlink()
    earlier("of-another", made_at_ms=1, node="node-2")
    (folder / "link").symlink_to(folder / "made-0")
    arguments = [str(config.data_dir), "--out", str(folder / "new"), "--json", "--keep", "2"]
    answer = json.loads(CliRunner().invoke(backup, arguments).stdout)
    assert answer["deleted"] == [str(folder / "made-1"), str(folder / "made-2")]
    left = {path.name for path in folder.iterdir()}
    assert left == {"made-0", "with-more", "incomplete", "of-another", "link", "new"}


@pytest.mark.parametrize(
    ("store", "public"),
    [
        ("sqlite", "sqlite"),
        ("mongodb://h:27017/db?replicaSet=rs", "mongodb://h:27017/db?replicaSet=rs"),
        ("mongodb://u:hunter%2F2@a:1,b:2/db?tls=true", "mongodb://u@a:1,b:2/db?tls=true"),
        ("mongodb+srv://u:hunter2@h", "mongodb+srv://u@h"),
        ("mongodb://u:hunter2@h?tlsCertificateKeyFilePassword=hunter2&w=1", "mongodb://u@h?w=1"),
        ("mongodb://h/db?tls=true;tlsCertificateKeyFilePassword=hunter2", "mongodb://h/db?tls=true"),
        (
            "mongodb://h/db?authMechanism=MONGODB-AWS&authMechanismProperties=AWS_SESSION_TOKEN:hunter2",
            "mongodb://h/db",
        ),
        ("mongodb://u@h/db?authMechanism=SCRAM-SHA-256", "mongodb://u@h/db?authMechanism=SCRAM-SHA-256"),
        ("mongodb://h?w=1;tls=true", "mongodb://h?w=1&tls=true"),
        ("mongodb://h?w=1;AUTHMECHANISMPROPERTIES=X:hunter2;w=2", "mongodb://h?w=1&w=2"),
        ("mongodb://h?w=1 authMechanismProperties=X:hunter2", "mongodb://h?w=1"),
        ("mongodb://u:hunter/2@h/db", None),
        ("mongodb://u:hunter?2@h/db", None),
    ],
)
def test_the_password_of_a_store_is_in_no_backup(
    config: NodeConfig, tmp_path: Path, store: str, public: str | None
) -> None:
    path = config.data_dir / "node.toml"
    path.write_text("# mine\n" + path.read_text().replace('store = "sqlite"', f'store = "{store}"'))
    said = CliRunner().invoke(backup, [str(config.data_dir), "--out", str(tmp_path / "backup"), "--json"])
    assert "hunter" not in said.output
    if public is None:
        assert json.loads(said.stdout)["error"]["code"] == "CONFIGURATION_INVALID"
        assert not (tmp_path / "backup").exists()
        return
    answer = json.loads(said.stdout)
    assert (answer["store_elsewhere"], answer["password_left_out"]) == (store != "sqlite", store != public)
    text = (tmp_path / "backup" / "node" / "node.toml").read_text()
    assert text == path.read_text().replace(store, public)
    spoken = CliRunner().invoke(backup, [str(config.data_dir), "--out", str(tmp_path / "again")]).stdout
    assert ("mongodump" in spoken, "password of MongoDB" in spoken) == (store != "sqlite", store != public)


def test_a_password_behind_escapes_is_refused(config: NodeConfig, tmp_path: Path) -> None:
    escaped = changed(config, 'store = "sqlite"', 'store = "mongodb://u:hunter\\u0032@h/db"')
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID.*escapes"):
        back_up(escaped, tmp_path / "backup", with_keys=False)


def test_a_backup_is_on_the_disk_before_it_has_its_name(
    config: NodeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[tuple[Path, bool]] = []
    out = tmp_path / "backup"
    monkeypatch.setattr(node_backup, "sync_folder", lambda path: synced.append((path, out.exists())))
    back_up(config, out, with_keys=True)
    before = {path.name for path, named in synced if not named}
    assert before >= {path.name for path in (out, *out.rglob("*"))}
    assert synced[-1] == (tmp_path, True)


async def test_a_node_is_made_anew_with_its_keys_from_elsewhere_and_starts(config: NodeConfig, tmp_path: Path) -> None:
    out, safe = tmp_path / "backup", tmp_path / "safe"
    back_up(config, out, with_keys=False)
    shutil.copytree(config.data_dir / "keys", safe)
    made = restored_from(out, tmp_path, keys=safe)
    assert (made.height, made.has_custody) == (0, False)
    anew = load_config(tmp_path / "anew")
    assert not anew.erase_keys_dir.exists()
    with LedgerFile(anew.ledger_dir) as ledger, ledger.snapshot() as view:
        assert view.position is not None
        assert view.position.height == 0
    port = find_base_port(1)
    elsewhere = replace(anew, p2p_port=port, api_port=port + 1, operator_port=port + 2)
    async with Node(elsewhere, restored=True) as node:
        assert node.describe()["finalized_height"] == 0


async def test_keys_of_another_node_make_no_node(tmp_path: Path) -> None:
    """The certificate and the proven ledger tell; a key of nobody may have replaced the one that the backup knows."""
    create_network(tmp_path / "network", nodes=2, organisations=2, base_port=find_base_port(2))
    own, other = (Cluster(tmp_path / "network").config(name) for name in ("node-1", "node-2"))
    async with Node(own):
        pass
    out = tmp_path / "backup"
    back_up(own, out, with_keys=False)

    def keys_with(name: str, content: bytes) -> Path:
        mixed = tmp_path / "mixed"
        shutil.rmtree(mixed, ignore_errors=True)
        shutil.copytree(own.data_dir / "keys", mixed)
        (mixed / name).write_bytes(content)
        return mixed

    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: .* names 'node-2', not this node"):
        restored_from(out, tmp_path, keys=other.data_dir / "keys")
    for name, said in (("tls.key.pem", "not that of the certificate"), ("producer.key", "is that of node-2")):
        with pytest.raises(BlockRobotError, match=rf"^FILE_UNUSABLE: .*{said}"):
            restored_from(out, tmp_path, keys=keys_with(name, (other.data_dir / "keys" / name).read_bytes()))
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: .*custodian key is not that of node-1"):
        restored_from(out, tmp_path, keys=keys_with("custodian.key", os.urandom(32)))
    assert not (tmp_path / "anew").exists()
    made = restored_from(out, tmp_path, keys=keys_with("producer.key", os.urandom(32)))
    assert "right only if it was replaced since" in made.warning


def test_what_a_custodian_kept_comes_back_only_with_the_newest_erase_keys(config: NodeConfig, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    assert back_up(config, out, with_keys=True).has("keys")
    made = restored_from(out, tmp_path, erase_keys=config.erase_keys_dir)
    assert made.has_custody
    anew = load_config(tmp_path / "anew")
    with sqlite3.connect(anew.custody_dir / "custody.sqlite3") as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    with EraseKeys(anew.erase_keys_dir) as keys:
        assert len(keys.held) == 3


async def test_a_custodian_whose_clips_lie_elsewhere_starts_again_without_its_erase_keys(
    config: NodeConfig, tmp_path: Path
) -> None:
    place, out = tmp_path / "clips", tmp_path / "backup"
    config = changed(config, 'store = "sqlite"', f'store = "sqlite"\nclips = "folder:{place}"')
    async with Node(config):
        pass
    back_up(config, out, with_keys=True)
    said = CliRunner().invoke(backup, [str(config.data_dir), "--out", str(tmp_path / "again")]).stdout
    assert "its custodian's rows" in said
    assert "and its clips" not in said
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .* --outside"):
        restored_from(out, tmp_path)
    made = restored_from(out, tmp_path, outside=[place])
    assert not made.has_custody
    async with Node(made.config, restored=True) as node:
        assert node.describe()["finalized_height"] == 0


@pytest.mark.parametrize("is_inside", [True, False])
async def test_a_folder_of_clips_that_no_backup_has_is_lost_if_it_was_the_nodes_own_and_else_asked_for(
    config: NodeConfig, tmp_path: Path, is_inside: bool
) -> None:
    place, out = tmp_path / "disk" / "clips", tmp_path / "backup"
    clips = "folder" if is_inside else f"folder:{place}"
    config = changed(config, 'store = "sqlite"', f'store = "sqlite"\nclips = "{clips}"')
    async with Node(config):
        pass
    back_up(config, out, with_keys=True)
    if not is_inside:
        place.parent.rename(tmp_path / "not mounted")
    made = restored_from(out, tmp_path, outside=[place])
    if not is_inside:
        with pytest.raises(BlockRobotError, match=r"^CLIPS_NOT_THERE"):
            async with Node(made.config, restored=True):
                pass
        assert not place.exists()
        return
    async with Node(made.config, restored=True) as node:
        assert node.describe()["finalized_height"] == 0


@pytest.mark.parametrize("with_erase_keys", [False, True])
def test_of_a_custodian_with_mongodb_the_place_of_its_clips_and_its_erase_keys_come_back(
    config: NodeConfig, tmp_path: Path, with_erase_keys: bool
) -> None:
    moved = changed(config, 'store = "sqlite"', 'store = "mongodb://h/db"\nclips = "s3://ward/node-1"')
    (config.custody_dir / "clips.json").write_text("the key of the names")
    assert back_up(moved, tmp_path / "backup", with_keys=True).has("custody/clips.json")
    said = CliRunner().invoke(backup, [str(config.data_dir), "--out", str(tmp_path / "again"), "--json"])
    assert json.loads(said.stdout)["has_custody"] is False
    made = restored_from(tmp_path / "backup", tmp_path, erase_keys=config.erase_keys_dir if with_erase_keys else None)
    assert (made.config.custody_dir / "clips.json").read_text() == "the key of the names"
    assert made.config.erase_keys_dir.exists() == with_erase_keys
    assert not made.has_custody


def test_keys_outside_of_the_nodes_folder_are_said_not_to_be_in_a_backup(config: NodeConfig, tmp_path: Path) -> None:
    safe = tmp_path / "safe"
    shutil.copytree(config.data_dir / "keys", safe)
    (config.data_dir / "keys" / "producer.key").unlink()
    apart = changed(config, 'producer = "keys/producer.key"', f'producer = "{safe / "producer.key"}"')
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .*safe/producer.key is not in"):
        back_up(apart, tmp_path / "backup", with_keys=True)
    back_up(apart, tmp_path / "backup", with_keys=False)
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE.*tls.crt.pem.*--keys"):
        restored_from(tmp_path / "backup", tmp_path, outside=[safe])
    made = restored_from(tmp_path / "backup", tmp_path, outside=[safe], keys=config.data_dir / "keys")
    assert made.config.producer_key_path == safe / "producer.key"


def test_a_genesis_file_by_another_name_is_in_a_backup(config: NodeConfig, tmp_path: Path) -> None:
    named = changed(config, 'genesis = "genesis.json"', 'genesis = "ward.json"')
    (config.data_dir / "genesis.json").rename(named.genesis_path)
    back_up(named, tmp_path / "backup", with_keys=True)
    assert restored_from(tmp_path / "backup", tmp_path).genesis == load_genesis(named)


def test_a_backup_is_not_made_without_the_genesis_file_that_it_needs(config: NodeConfig, tmp_path: Path) -> None:
    below = changed(config, 'genesis = "genesis.json"', 'genesis = "of-network/genesis.json"')
    below.genesis_path.parent.mkdir()
    (config.data_dir / "genesis.json").rename(below.genesis_path)
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .* beside node.toml"):
        back_up(below, tmp_path / "backup", with_keys=True)
    assert not (tmp_path / "backup").exists()


def test_what_a_cut_leaves_of_a_backup_or_a_restore_is_removed_by_the_next(
    config: NodeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A child that is killed in the middle, as by a power cut or a shutdown."""

    def killed(work: Callable[[], object]) -> None:
        child = os.fork()
        if not child:
            with monkeypatch.context() as patch:
                for name in ("sync_folder", "restore_ledger"):
                    patch.setattr(node_backup, name, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
                work()
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL

    folder, anew = tmp_path / "backups", tmp_path / "nodes" / "anew"
    back_up(config, folder / "whole", with_keys=True)
    killed(lambda: back_up(config, folder / "first", with_keys=True))
    killed(lambda: node_backup.restore(folder / "whole", anew))
    assert [len(list(place.rglob("*.key"))) for place in (folder, anew.parent)] == [4, 2]
    made = back_up(config, folder / "second", with_keys=False)
    killed(lambda: node_backup.delete_old(folder / "second", made, 1))
    node_backup.restore(folder / "second", anew, keys=config.data_dir / "keys")
    back_up(config, folder / "third", with_keys=False)
    assert {path.name for path in folder.iterdir()} == {"second", "third"}
    assert [path.name for path in anew.parent.iterdir()] == ["anew"]


def test_whatever_a_cut_leaves_of_a_removal_is_removed_by_the_next(config: NodeConfig, tmp_path: Path) -> None:
    folder = tmp_path / "backups"
    made = back_up(config, folder / "new", with_keys=False)

    def delete_another() -> None:
        shutil.copytree(folder / "new", folder / "old")
        node_backup.delete_old(folder / "new", made, 1)

    removals = 1
    while is_killed_after(removals, delete_another):
        delete_another()
        assert [path.name for path in folder.iterdir()] == ["new"]
        removals += 1
    assert removals - 1 > len(list((folder / "new").rglob("*")))


def test_a_folder_of_somebodys_by_the_name_of_half_a_node_is_left_as_it_is(config: NodeConfig, tmp_path: Path) -> None:
    back_up(config, tmp_path / "backup", with_keys=True)
    mine = tmp_path / ".anew.halfdone" / "mine"
    mine.mkdir(parents=True)
    with pytest.raises(BlockRobotError, match=r"^FILE_EXISTS"):
        restored_from(tmp_path / "backup", tmp_path)
    assert mine.is_dir()
    mine.rmdir()
    restored_from(tmp_path / "backup", tmp_path)
    assert not mine.parent.exists()


def test_two_backups_of_a_node_do_not_take_each_others_files(config: NodeConfig, tmp_path: Path) -> None:
    def tell(step: str) -> None:
        if step == "ledger":
            with pytest.raises(BlockRobotError, match=r"^DATA_DIRECTORY_IN_USE"):
                back_up(config, tmp_path / "second", with_keys=False)

    back_up(config, tmp_path / "first", with_keys=False, tell=tell)
    assert read_backup(tmp_path / "first")


@pytest.mark.parametrize("harm", ["changed", "missing", "added", "linked", "version", "not a backup", "no keys"])
def test_a_backup_that_is_not_whole_makes_no_node(config: NodeConfig, tmp_path: Path, harm: str) -> None:
    out = tmp_path / "backup"
    made = back_up(config, out, with_keys=harm != "no keys")
    name = next(name for name in made.files if name.startswith("ledger/"))
    if harm == "changed":
        (out / name).write_bytes(b"x" + (out / name).read_bytes()[1:])
    elif harm == "missing":
        (out / name).unlink()
    elif harm == "added":
        (out / "node" / "more.toml").write_text("")
    elif harm == "linked":
        (out / "node" / "link").symlink_to(config.data_dir)
    elif harm == "version":
        manifest = msgspec.structs.replace(made, version=2)
        (out / MANIFEST_FILE).write_bytes(msgspec.json.encode(manifest))
    elif harm == "not a backup":
        (out / MANIFEST_FILE).write_text("[" * 100_000)
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE"):
        restored_from(out, tmp_path)
    assert not (tmp_path / "anew").exists()
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_both_commands_say_what_they_did_and_what_is_next(config: NodeConfig, tmp_path: Path) -> None:
    out, place = str(tmp_path / "backup"), str(tmp_path / "anew")
    said = CliRunner().invoke(backup, [str(config.data_dir), "--out", out, "--json"])
    answer = json.loads(said.stdout)
    assert (answer["node"], answer["has_keys"], answer["has_custody"]) == ("node-1", False, True)
    assert msgspec.json.decode((Path(out) / MANIFEST_FILE).read_bytes(), type=BackupManifest).node == "node-1"
    refused = CliRunner().invoke(restore, [out, "--data-dir", place])
    assert "--keys" in refused.stderr
    keys = ["--keys", str(config.data_dir / "keys")]
    said = CliRunner().invoke(restore, [out, "--data-dir", place, *keys])
    assert said.exit_code == 0, said.output
    assert f"blockrobot node run {place} --restored" in said.output
    again = CliRunner().invoke(restore, [out, "--data-dir", place, *keys])
    assert "NODE_EXISTS" in again.stderr


@pytest.mark.parametrize(("count", "stops"), [(1, False), (3, True), (4, False)])
async def test_who_restores_one_of_two_or_three_producers_is_told_that_it_stops_the_network(
    count: int, stops: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create_network(tmp_path / "network", nodes=count, organisations=1, base_port=find_base_port(count))
    config = Cluster(tmp_path / "network").config("node-1")
    async with Node(config):
        pass
    back_up(config, tmp_path / "backup", with_keys=True)
    answer = CliRunner().invoke(restore, [str(tmp_path / "backup"), "--data-dir", str(tmp_path / "anew"), "--json"])
    warning = json.loads(answer.output)["warning"]
    assert (f"one of {count} producers" in warning) == stops
    assert bool(warning) == stops
    monkeypatch.setattr(node_run_commands, "can_ask", lambda: True)
    monkeypatch.setattr(node_run_commands, "run_process", lambda *_: 0)
    started = CliRunner().invoke(node_run_commands.run, [str(tmp_path / "anew"), "--restored"], input="n\n")
    assert (started.exit_code, "locked out for good" in started.output) == (int(stops), stops)
