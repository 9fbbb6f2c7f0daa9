"""A backup that somebody changed makes no node that does what they want."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from network.cli.node.backup_commands import restore
from network.provisioning.founding import fingerprint
from network.provisioning.network_layout import create_network
from network.provisioning.node_backup import MANIFEST_FILE, BackupManifest, back_up
from node.config import NodeConfig, load_genesis
from node.directory.directory_file import encode_directory
from node.directory.node_directory import DirectoryContent, DirectoryOrganisation, content_of_genesis
from node.node_process import Node
from tests.cluster.network_under_test import find_base_port
from tests.unit.network.backup.conftest import restored_from

FALSE_DIRECTORY = DirectoryContent(10**12, {}, {"hospital": DirectoryOrganisation("hospital", "of somebody else")})


def forged(out: Path, name: str, content: str | None = None) -> None:
    """As somebody would who can write where backups lie: with the hash that belongs to it, or to what is there."""
    if content is not None:
        (out / name).write_text(content)
    made = read_manifest(out)
    digest = hashlib.sha256((out / name).read_bytes()).hexdigest()
    files = {**made.files, name: digest}
    (out / MANIFEST_FILE).write_bytes(msgspec.json.encode(msgspec.structs.replace(made, files=files)))


def read_manifest(out: Path) -> BackupManifest:
    return msgspec.json.decode((out / MANIFEST_FILE).read_bytes(), type=BackupManifest)


def test_a_backup_names_no_file_outside_of_its_node(config: NodeConfig, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    back_up(config, out, with_keys=True)
    text = (out / "node" / "node.toml").read_text()
    text = text.replace("[custody]\n", '[custody]\nclips = ""\nclips_credentials = ""\nclips_ca = ""\n')
    inside = {"clips": "s3://bucket", "clips_credentials": "keys/s3", "clips_ca": "keys/ca"}
    paths = ("/etc/hostname", "../../elsewhere/file", "keys/../../file")
    changes = [(field, path) for field in ("tls_certificate", "tls_key", "producer", "custodian") for path in paths]
    changes += [(field, path) for field in ("genesis", "clips_credentials", "clips_ca") for path in paths]
    changes += [("clips", f"folder:{path}") for path in paths]
    changes += [
        ("store", f"mongodb://h/db?tls=true{mark}{option}={paths[0]}")
        for option in ("tlsCAFile", "TLScertificateKEYfile")
        for mark in ("&", ";", " ")
    ]
    for change in changes:
        changed = text
        for field, value in {**inside, **dict([change])}.items():
            changed, count = re.subn(rf'(?m)^{field} = ".*"$', f'{field} = "{value}"', changed)
            assert count == 1
        forged(out, "node/node.toml", changed)
        with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .* outside of the node's folder"):
            restored_from(out, tmp_path)
        assert not (tmp_path / "anew").exists()


def with_settings(config: NodeConfig, tmp_path: Path, before: str, after: str) -> Path:
    """A backup whose settings were changed."""
    out = tmp_path / "backup"
    back_up(config, out, with_keys=True)
    forged(out, "node/node.toml", (out / "node" / "node.toml").read_text().replace(before, after))
    return out


@pytest.mark.parametrize(
    "options",
    [
        "authMechanism=MONGODB-OIDC&authMechanismProperties=ENVIRONMENT:azure,TOKEN_RESOURCE:ward",
        "authMechanism=MONGODB-OIDC",
        "authmechanism=MONGODB%2DAWS",
        "authMechanism=GSSAPI",
        "w=1;authMechanism=MONGODB-OIDC",
        "w=1 tlsCAFile=/etc/hostname",
        "tlsInsecure=true",
        "%61uthMechanism=MONGODB-OIDC",
    ],
)
def test_a_changed_backup_hands_no_credentials_of_this_host_to_a_database(
    config: NodeConfig, tmp_path: Path, options: str
) -> None:
    """The driver asks the cloud that it runs in for a token, or reads one, and gives it to whatever server is named."""
    out = with_settings(config, tmp_path, 'store = "sqlite"', f'store = "mongodb://h/db?{options}"')
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .*(outside of the node|which no backup holds)"):
        restored_from(out, tmp_path)
    assert not (tmp_path / "anew").exists()


async def test_what_a_changed_backup_lets_a_custodian_owe_is_signed_by_nobody(
    config: NodeConfig, tmp_path: Path
) -> None:
    """A receipt for an erasure that comes later, a plan to erase, a request of nobody, blocks that are to be skipped."""
    out, database = tmp_path / "backup", tmp_path / "backup" / "custody" / "custody.sqlite3"
    back_up(config, out, with_keys=True)
    forge = (
        "INSERT INTO outbox VALUES ('erasure.receipt', x'01', 0, 'erasure', 'receipt', x'90', 1, 'ready', x'')",
        "INSERT INTO outbox VALUES ('erasure.expired', x'02', 0, 'erasure', 'expired', x'90', 1, 'erasing', x'90')",
        "INSERT INTO grants VALUES (x'03', x'04', x'90', 1, x'')",
        "INSERT OR REPLACE INTO checkpoint VALUES (1, 1000000, x'05', 1)",
    )
    with closing(sqlite3.connect(database)) as opened, opened:
        for statement in forge:
            opened.execute(statement)
    forged(out, "custody/custody.sqlite3")
    made = restored_from(out, tmp_path, erase_keys=config.erase_keys_dir)
    assert made.has_custody
    with closing(sqlite3.connect(made.config.custody_dir / "custody.sqlite3")) as opened:
        for table in ("outbox", "grants", "checkpoint"):
            assert opened.execute(f"SELECT count(*) FROM {table}").fetchone() == (0,), table
    async with Node(made.config, restored=True) as node, asyncio.timeout(60):
        custody = node._parts.custody
        assert custody is not None
        async with custody._followed:
            await custody._followed.wait_for(lambda: custody.checkpoint_height == 0)

    shutil.rmtree(tmp_path / "anew")
    for harm in (
        "CREATE TRIGGER again AFTER INSERT ON checkpoint BEGIN INSERT INTO outbox SELECT * FROM kept; END",
        "CREATE VIEW kept AS SELECT * FROM outbox",
        "DROP TABLE day_uses",
        "PRAGMA user_version = 0",
    ):
        whole = database.read_bytes()
        with closing(sqlite3.connect(database)) as opened, opened:
            opened.execute(harm)
        forged(out, "custody/custody.sqlite3")
        with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: .*custody.sqlite3"):
            restored_from(out, tmp_path, erase_keys=config.erase_keys_dir)
        assert not (tmp_path / "anew").exists()
        database.write_bytes(whole)
    forged(out, "custody/custody.sqlite3", "no database at all, but as long as its first page is " * 100)
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: .*custody.sqlite3"):
        restored_from(out, tmp_path, erase_keys=config.erase_keys_dir)


async def test_a_changed_backup_brings_no_file_by_its_name(config: NodeConfig, tmp_path: Path) -> None:
    """Tokens of its author, a wrong clock, authorities of theirs until a block that never comes, a move half done."""
    out = tmp_path / "backup"
    (config.data_dir / "directory.json").write_bytes(encode_directory(load_genesis(config).chain_id, FALSE_DIRECTORY))
    back_up(config, out, with_keys=True)
    assert {path.name for path in (out / "node").iterdir()} == {"node.toml", "genesis.json"}
    text = (out / "node" / "node.toml").read_text()
    for name, content in {
        "directory.json": (config.data_dir / "directory.json").read_text(),
        "operator.token": "a" * 64,
        "operator-read.token": "b" * 64,
        "faults.json": '{"seed": 1, "links": {}, "clock_offset_ms": 3600000, "disk": []}',
        "node.toml.moving": text.replace("keys/producer.key", "/elsewhere/producer.key"),
        "aws.ini": "[default]",
    }.items():
        forged(out, f"node/{name}", content)
    made = restored_from(out, tmp_path)
    assert {path.name for path in (tmp_path / "anew").iterdir()} == {"node.toml", "genesis.json", "keys", "ledger"}
    async with Node(made.config, restored=True) as node:
        assert node._parts.directory.content == content_of_genesis(made.genesis)
        assert (tmp_path / "anew" / "operator.token").read_text() != "a" * 64
    for name in ("operator.token", "faults.json", "directory.json", "node.toml"):
        shutil.rmtree(tmp_path / "anew", ignore_errors=True)
        forged(out, f"node/{name}", genesis_to_json(made.genesis))
        forged(out, "node/node.toml", text.replace('genesis = "genesis.json"', f'genesis = "{name}"'))
        with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: .* genesis.json"):
            restored_from(out, tmp_path)


def test_a_backup_with_another_networks_genesis_file_makes_no_node(config: NodeConfig, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    back_up(config, out, with_keys=True)
    own, other = load_genesis(config), tmp_path / "other"
    false = create_network(other, nodes=1, organisations=1, base_port=20_000)
    restored = restored_from(out, tmp_path, genesis=own)
    assert restored.genesis == own
    shutil.rmtree(tmp_path / "anew")
    with pytest.raises(BlockRobotError, match=r"^GENESIS_DIFFERS"):
        restored_from(out, tmp_path, genesis=false)
    forged(out, "node/genesis.json", genesis_to_json(false))
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE"):
        restored_from(out, tmp_path)
    manifest = msgspec.structs.replace(read_manifest(out), chain_id=false.chain_id.hex())
    (out / MANIFEST_FILE).write_bytes(msgspec.json.encode(manifest))
    with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_OTHER_CHAIN"):
        restored_from(out, tmp_path)
    assert not (tmp_path / "anew").exists()


def test_settings_that_open_a_restored_node_are_shown(config: NodeConfig, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    back_up(config, out, with_keys=True)
    text = (out / "node" / "node.toml").read_text()
    opened = text.replace("[listen]\n", '[listen]\ntrusted_proxies = ["0.0.0.0/0"]\n')
    opened = opened.replace(
        'store = "sqlite"', 'store = "mongodb://me:secret@10.0.0.9,10.0.0.66:27018/ward?replicaSet=r"'
    )
    opened = opened.replace(
        "[custody]\n",
        '[custody]\nclips = "s3://ward/x"\nclips_endpoint = "https://10.0.0.8"\n'
        'clips_credentials = "keys/s3"\nclips_ca = "keys/ca"\n',
    )
    opened = opened.replace("keys/producer.key", str(config.producer_key_path))
    outside = ["--outside", str(config.data_dir)]
    port = find_base_port(1)
    forged(out, "node/node.toml", opened + f'\n[metrics]\nhost = "0.0.0.0"\nport = {port}\n[faults]\nenabled = true\n')
    for number, options in enumerate(([], ["--json"])):
        said = CliRunner().invoke(
            restore, [str(out), "--data-dir", str(tmp_path / f"anew-{number}"), *outside, *options]
        )
        assert said.exit_code == 0, said.output
        assert "secret" not in said.output
        for name in ("trusted_proxies", "metrics_host", "faults_enabled", "custody_store"):
            assert name in said.output
        assert all(
            value in said.output
            for value in ("0.0.0.0/0", "0.0.0.0", "mongodb://me@10.0.0.9,10.0.0.66:27018/ward?replicaSet=r")
        )
    answer = json.loads(said.stdout)
    assert answer["settings"]["clips"] == "s3://ward/x at https://10.0.0.8, with keys of keys/s3, checked by keys/ca"
    assert answer["settings"]["producer_key_path"] == str(config.producer_key_path)
    assert {"clips", "producer_key_path"} <= set(answer["changed_settings"])
    assert "tls_key_path" not in answer["settings"]
    assert answer["fingerprint"] == fingerprint(load_genesis(config))
    assert {"trusted_proxies", "metrics_host", "faults_enabled"} <= set(answer["changed_settings"])
    assert "public_explorer" not in answer["changed_settings"]
    assert answer["settings"]["public_explorer"] is False


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ('clips = "s3://[x/y"', "clips"),
        ('clips = "s3://ward/x"\nclips_endpoint = "https://[x"', "clips"),
        ('clips = "folder:a\\u0000b"', "clips"),
    ],
)
def test_a_changed_backup_that_names_no_real_place_is_refused(
    config: NodeConfig, tmp_path: Path, place: str, said: str
) -> None:
    out = with_settings(config, tmp_path, "[custody]\n", f"[custody]\n{place}\n")
    with pytest.raises(BlockRobotError, match=f"^CONFIGURATION_INVALID: .*{said}"):
        restored_from(out, tmp_path)
    assert not (tmp_path / "anew").exists()
