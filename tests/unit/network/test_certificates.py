"""Certificates are renewed in place: the node's files fit together at any moment, and nobody else can read the key."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.provisioning.certificate_authority import (
    certified_hosts,
    create_authority,
    encode_private_key,
    write_secret,
)
from network.provisioning.network_layout import create_network
from network.provisioning.node_certificates import (
    DAY_MS,
    get_authority,
    issue_into,
    now_ms,
    parse_serial,
    read_report,
    renew,
    serial_bytes,
)
from node.config import NodeConfig


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    create_network(tmp_path / "network", nodes=2, organisations=2, base_port=20_000)
    return tmp_path / "network"


@pytest.fixture
def config(folder: Path) -> NodeConfig:
    return Cluster(folder).config("node-1")


def test_a_new_network_has_certificates_that_count(config: NodeConfig) -> None:
    report = read_report(config)
    assert report.facts is not None
    assert (report.facts.name, report.facts.organisation) == ("node-1", "hospital")
    assert report.state(now_ms()) == "valid"


def test_renewing_keeps_the_key_and_changes_the_serial(folder: Path, config: NodeConfig) -> None:
    before, key = read_report(config), config.tls_key_path.read_bytes()
    serial = renew(config, get_authority(folder, "hospital"), days=400)
    after = read_report(config)
    assert before.facts is not None
    assert after.facts is not None
    assert after.facts.serial == serial != before.facts.serial
    assert config.tls_key_path.read_bytes() == key
    assert 399 <= after.days_left(now_ms()) <= 400
    assert after.state(now_ms()) == "valid"


def test_renewing_keeps_the_addresses_at_which_others_reach_the_node(folder: Path, config: NodeConfig) -> None:
    keys = config.tls_certificate_path.parent
    for path in (config.tls_certificate_path, config.tls_key_path):
        path.unlink()
    issue_into(keys, get_authority(folder, "hospital"), "node-1", "10.0.0.7", "node-1.clinic.example")
    renew(config, get_authority(folder, "hospital"))
    renewed = x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())
    assert certified_hosts(renewed) == ("10.0.0.7", "node-1.clinic.example")


def test_a_new_key_comes_with_a_certificate_that_fits(folder: Path, config: NodeConfig) -> None:
    key = config.tls_key_path.read_bytes()
    renew(config, get_authority(folder, "hospital"), new_key=True)
    assert config.tls_key_path.read_bytes() != key
    assert read_report(config).state(now_ms()) == "valid"
    assert stat.S_IMODE(config.tls_key_path.stat().st_mode) == 0o600
    assert {path.name for path in config.tls_key_path.parent.iterdir() if path.name.startswith("tls")} == {
        "tls.crt.pem",
        "tls.key.pem",
    }


def test_what_is_left_of_a_renewal_that_was_cut_off_does_not_stop_the_next(folder: Path, config: NodeConfig) -> None:
    config.tls_certificate_path.with_name("tls.crt.pem.new").write_bytes(b"half")
    renew(config, get_authority(folder, "hospital"))
    assert read_report(config).state(now_ms()) == "valid"


def test_the_days_before_the_end_are_named(folder: Path, config: NodeConfig) -> None:
    renew(config, get_authority(folder, "hospital"), days=20)
    report = read_report(config)
    assert report.state(now_ms()) == "expiring"
    assert report.state(now_ms() + 21 * DAY_MS) == "expired"
    assert report.days_left(now_ms() + 21 * DAY_MS) < 0
    assert report.facts is not None
    assert report.state(now_ms(), frozenset({("hospital", report.facts.serial)})) == "revoked"


@pytest.mark.parametrize("broken", ["tls_certificate_path", "tls_key_path"])
def test_files_that_cannot_be_used_are_named(config: NodeConfig, broken: str) -> None:
    getattr(config, broken).write_bytes(b"rubbish")
    report = read_report(config)
    assert report.state(now_ms()) == "unusable"
    assert "cannot be read" in report.trouble


def test_a_lost_or_foreign_key_is_named_and_cannot_be_kept(folder: Path, config: NodeConfig) -> None:
    other = Cluster(folder).config("node-2")
    config.tls_key_path.write_bytes(other.tls_key_path.read_bytes())
    assert read_report(config).trouble == "The key is not that of the certificate."
    config.tls_certificate_path.write_bytes(other.tls_certificate_path.read_bytes())
    assert "'node-2'" in read_report(config).trouble
    config.tls_key_path.unlink()
    with pytest.raises(BlockRobotError, match="--new-key"):
        renew(config, get_authority(folder, "hospital"))
    renew(config, get_authority(folder, "hospital"), new_key=True)
    assert read_report(config).state(now_ms()) == "valid"


def test_issuing_never_overwrites_and_names_an_authority_that_is_not_here(tmp_path: Path, folder: Path) -> None:
    authority = get_authority(folder, "university")
    issue_into(tmp_path / "keys", authority, "node-9", "ward.example")
    with pytest.raises(FileExistsError):
        issue_into(tmp_path / "keys", authority, "node-9", "127.0.0.1")
    (tmp_path / "keys" / "tls.key.pem").unlink()
    with pytest.raises(FileExistsError):
        issue_into(tmp_path / "keys", authority, "node-9", "127.0.0.1")
    assert [path.name for path in (tmp_path / "keys").iterdir()] == ["tls.crt.pem"], "no key that does not fit"
    with pytest.raises(BlockRobotError, match="AUTHORITY_NOT_HERE"):
        get_authority(folder, "clinic")
    wrong, other = create_authority("clinic"), create_authority("clinic")
    write_secret(tmp_path / "ca" / "ca.key.pem", encode_private_key(other.key))
    (tmp_path / "ca" / "ca.crt.pem").write_text(wrong.certificate_pem)
    with pytest.raises(BlockRobotError, match="not that of its certificate"):
        get_authority(folder, "clinic", tmp_path / "ca")
    usual = rsa.generate_private_key(65537, 2048).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (tmp_path / "ca" / "ca.key.pem").write_bytes(usual)
    with pytest.raises(BlockRobotError, match=r"not of an elliptic curve.*certificate request"):
        get_authority(folder, "clinic", tmp_path / "ca")


def test_serial_numbers_are_read_and_written_as_the_contract_takes_them() -> None:
    assert serial_bytes(parse_serial("ff01")) == bytes(18) + b"\xff\x01"
    for text in ("", "0", "xyz", "1" * 41):
        with pytest.raises(BlockRobotError, match="SERIAL_INVALID"):
            parse_serial(text)
