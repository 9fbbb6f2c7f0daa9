"""Each thing in a data directory is broken on purpose, and the doctor names it."""

from __future__ import annotations

import asyncio
import shutil
import socket
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.doctor.data_directory import check_authorities, check_directory, check_disk
from network.doctor.examination import Examination, examine_network, examine_node
from network.doctor.findings import Finding
from network.provisioning.network_layout import create_network
from network.provisioning.node_certificates import DAY_MS, get_authority, now_ms, read_report, renew
from node.clips_place import read_place
from node.config import NodeConfig, config_to_toml, load_genesis
from node.directory.node_directory import DirectoryContent, content_of_genesis
from node.node_process import open_ledger
from node.storage.directory_lock import DirectoryLock
from tests.cluster.network_under_test import find_base_port

GIB = 2**30


@pytest.fixture(scope="module")
def founded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    network = tmp_path_factory.mktemp("founded") / "network"
    create_network(network, nodes=2, organisations=2, base_port=find_base_port(2))
    return network


@pytest.fixture
def folder(founded: Path, tmp_path: Path) -> Path:
    """A copy for each test: its files name no place."""
    return Path(shutil.copytree(founded, tmp_path / "network"))


@pytest.fixture
def config(folder: Path) -> NodeConfig:
    return Cluster(folder).config("node-1")


@pytest.fixture
def directory(folder: Path) -> DirectoryContent:
    return content_of_genesis(Cluster(folder).genesis)


def codes(findings: list[Finding]) -> list[str]:
    return [finding.code for finding in findings]


def of(examination: Examination, name: str) -> set[str]:
    """The codes found for one node; how full this machine's disk is does not matter here."""
    return {finding.code for finding in examination.findings if finding.node == name} - {"DISK_LOW"}


def test_a_data_directory_is_sound_until_others_can_read_it_or_its_keys(
    config: NodeConfig, directory: DirectoryContent
) -> None:
    assert check_directory(config, directory, now_ms(), (20 * GIB, 40 * GIB)) == []
    config.data_dir.chmod(0o755)
    found = check_directory(config, directory, now_ms(), (20 * GIB, 40 * GIB))
    assert [finding.detail for finding in found] == ["the data directory has mode 755."]
    config.data_dir.chmod(0o700)
    config.tls_key_path.chmod(0o640)
    assert config.producer_key_path is not None
    config.producer_key_path.unlink()
    found = check_directory(config, directory, now_ms(), (20 * GIB, 40 * GIB))
    assert codes(found) == ["KEY_FILE_MISSING", "KEY_FILE_EXPOSED"]
    assert found[1].detail == "keys/tls.key.pem has mode 640."


def test_a_certificate_near_its_end_over_it_and_revoked(
    folder: Path, config: NodeConfig, directory: DirectoryContent
) -> None:
    renew(config, get_authority(folder, "hospital"), days=10)
    room = (20 * GIB, 40 * GIB)
    assert codes(check_directory(config, directory, now_ms(), room)) == ["CERTIFICATE_EXPIRES_SOON"]
    assert codes(check_directory(config, directory, now_ms() + 11 * DAY_MS, room)) == ["CERTIFICATE_EXPIRED"]
    facts = read_report(config).facts
    assert facts is not None
    revoked = DirectoryContent(
        1, directory.nodes, directory.organisations, frozenset({(facts.organisation, facts.serial)})
    )
    assert codes(check_directory(config, revoked, now_ms(), room)) == ["CERTIFICATE_REVOKED"]


def test_a_certificate_that_does_not_name_where_the_node_has_moved_to(
    config: NodeConfig, directory: DirectoryContent
) -> None:
    moved = replace(directory.nodes["node-1"], host="10.0.0.9", api_url="https://10.0.0.9:7273")
    known = replace(directory, nodes={**directory.nodes, "node-1": moved})
    [found] = check_directory(config, known, now_ms(), (20 * GIB, 40 * GIB))
    assert (found.code, "10.0.0.9" in found.detail) == ("CERTIFICATE_UNFIT", True)


@pytest.mark.parametrize(("free", "total"), [(100 * 2**20, 400 * GIB), (2 * GIB, 400 * GIB)])
def test_a_disk_that_is_nearly_full(config: NodeConfig, free: int, total: int) -> None:
    assert codes(check_disk(config, (free, total))) == ["DISK_LOW"]


def test_a_disk_of_its_own_for_clips_is_looked_at_as_the_nodes_is(
    config: NodeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = tmp_path / "clips"
    clips.mkdir()
    config = replace(config, clips=read_place(f"folder:{clips}", config.data_dir))
    free = {config.data_dir: 20 * GIB, clips: 0}
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(total=40 * GIB, free=free[place]))
    (found,) = check_disk(config)
    assert (found.code, found.detail) == ("DISK_LOW", f"0 MiB of 40960 MiB are free at {clips}.")
    free[config.data_dir] = 0
    assert codes(check_disk(config)) == ["DISK_LOW"], "one disk, one finding"


def test_keys_outside_of_the_data_directory_are_looked_at_too(
    config: NodeConfig, directory: DirectoryContent, tmp_path: Path
) -> None:
    safe = tmp_path / "safe"
    config.tls_key_path.parent.rename(safe)
    paths = {"tls_certificate_path": safe / "tls.crt.pem", "tls_key_path": safe / "tls.key.pem"}
    apart = replace(config, **paths, producer_key_path=safe / "gone.key", custodian_key_path=None)
    apart.tls_key_path.chmod(0o640)
    found = check_directory(apart, directory, now_ms(), (20 * GIB, 40 * GIB))
    assert codes(found) == ["KEY_FILE_MISSING", "KEY_FILE_EXPOSED"]
    assert [each.detail.split()[0] for each in found] == [f"{safe}/gone.key", f"{safe}/tls.key.pem"]


def test_a_journal_that_is_gone_or_damaged(config: NodeConfig, directory: DirectoryContent) -> None:
    room = (20 * GIB, 40 * GIB)
    config.journal_path.write_bytes(b"rubbish, not a journal")
    assert codes(check_directory(config, directory, now_ms(), room)) == ["JOURNAL_DAMAGED"]
    config.journal_path.unlink()
    assert codes(check_directory(config, directory, now_ms(), room)) == ["JOURNAL_MISSING"]


def test_authorities_in_their_last_year_or_that_cannot_be_read_are_named(directory: DirectoryContent) -> None:
    assert check_authorities(directory, now_ms()) == []
    assert codes(check_authorities(directory, now_ms() + 10 * 365 * DAY_MS - 30 * DAY_MS)) == [
        "AUTHORITY_EXPIRES_SOON",
        "AUTHORITY_EXPIRES_SOON",
    ]
    damaged = {**directory.organisations}
    damaged["university"] = replace(damaged["university"], ca_certificate="-----BEGIN CERTIFICATE-----\nAA==\n")
    (found,) = check_authorities(replace(directory, organisations=damaged), now_ms())
    assert (found.code, found.kind.severity) == ("AUTHORITY_UNREADABLE", "problem")
    assert "university" in found.detail
    damaged["university"] = replace(damaged["university"], is_active=False)
    assert check_authorities(replace(directory, organisations=damaged), now_ms()) == []


def test_a_port_for_metrics_that_another_program_took(config: NodeConfig) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = replace(config, metrics_host="127.0.0.1", metrics_port=taken.getsockname()[1])
        (config.data_dir / "node.toml").write_text(config_to_toml(settings))
        assert "PORT_TAKEN" in of(examine_node(config.data_dir), "node-1")
    assert "PORT_TAKEN" not in of(examine_node(config.data_dir), "node-1")


def test_nodes_that_do_not_run_and_a_port_that_another_program_took(folder: Path, config: NodeConfig) -> None:
    with socket.create_server(("127.0.0.1", config.api_port)):
        examination = examine_network(folder)
    assert not examination.ok
    assert {"NODE_DOWN", "PORT_TAKEN"} <= of(examination, "node-1")
    assert of(examination, "node-2") & {"NODE_DOWN", "PORT_TAKEN"} == {"NODE_DOWN"}


def test_a_node_that_holds_its_directory_but_says_nothing_is_silent_not_down(config: NodeConfig) -> None:
    lock = DirectoryLock(config.data_dir)
    try:
        assert of(examine_node(config.data_dir), "node-1") == {"NODE_SILENT"}
    finally:
        lock.release()
    assert of(examine_node(config.data_dir), "node-1") == {"NODE_DOWN"}


def test_a_configuration_that_cannot_be_read_hides_no_other_node(folder: Path, config: NodeConfig) -> None:
    (config.data_dir / "node.toml").write_text("[node]\nname = 7\n")
    examination = examine_network(folder)
    assert of(examination, "node-1") == {"CONFIGURATION_WRONG"}
    assert "NODE_DOWN" in of(examination, "node-2")


def test_a_node_of_another_network(tmp_path: Path, folder: Path, config: NodeConfig) -> None:
    other = tmp_path / "other"
    create_network(other, nodes=2, organisations=2, base_port=20_000)
    config.genesis_path.write_bytes((other / "genesis.json").read_bytes())
    assert of(examine_network(folder), "node-1") == {"GENESIS_DIFFERS"}


async def test_a_ledger_that_has_begun_by_another_genesis_file(tmp_path: Path, config: NodeConfig) -> None:
    genesis = load_genesis(config)
    await (await open_ledger(config, genesis)).close()
    assert of(await asyncio.to_thread(examine_node, config.data_dir), "node-1") == {"NODE_DOWN"}
    other = create_network(tmp_path / "other", nodes=2, organisations=2, base_port=20_000)
    config.genesis_path.write_text(genesis_to_json(other))
    with pytest.raises(BlockRobotError, match="GENESIS_IN_USE"):
        await open_ledger(config, other)
    found = of(await asyncio.to_thread(examine_node, config.data_dir), "node-1")
    assert "LEDGER_FOREIGN" in found
    assert "LEDGER_DAMAGED" not in found


@pytest.mark.parametrize("content", [b"", b"rubbish" * 2_000])
def test_a_ledger_that_is_no_ledger(folder: Path, config: NodeConfig, content: bytes) -> None:
    config.ledger_dir.mkdir(exist_ok=True)
    (config.ledger_dir / "data.mdb").write_bytes(content)
    assert "LEDGER_DAMAGED" in of(examine_network(folder), "node-1")
    assert "LEDGER_DAMAGED" not in of(examine_network(folder), "node-2")
