"""What organisations hand to each other holds public halves only, whatever else stood in the file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import create_authority, encode_private_key
from network.provisioning.exchange_files import (
    HANDED_OVER_MAX_BYTES,
    ORGANISATION_ENTRY_FILE,
    read_authority_certificates,
    read_certificate,
    read_node_entry,
    read_organisation_entry,
)
from network.provisioning.new_organisation import create_organisation

OLD, NEW = create_authority("hospital"), create_authority("hospital")


def refusal(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    codes = set()
    for read in (read_authority_certificates, read_organisation_entry, read_node_entry):
        with pytest.raises(BlockRobotError) as caught:
            read(path)
        codes.add(caught.value.code)
        assert str(path) in caught.value.detail
    (code,) = codes
    return code


def test_certificates_alone_are_taken_and_a_private_key_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "both.pem"
    wordy = f"\ufeffour own notes\r\n{OLD.certificate_pem}password: hunter2\n{NEW.certificate_pem.rstrip()}"
    path.write_text(wordy, "utf-8")
    assert read_authority_certificates(path) == OLD.certificate_pem + NEW.certificate_pem
    key = encode_private_key(OLD.key)
    kinds = (b"PRIVATE KEY", b"RSA PRIVATE KEY", b"EC PRIVATE KEY", b"ENCRYPTED PRIVATE KEY", b"OPENSSH PRIVATE KEY")
    for kind in kinds:
        for data in (OLD.certificate_pem.encode() + key, key + OLD.certificate_pem.encode(), key):
            assert refusal(tmp_path / "bundle.pem", data.replace(b"PRIVATE KEY", kind)) == "FILE_HOLDS_PRIVATE_KEY"


@pytest.mark.parametrize(
    "data", [b"", b"[]", b"{}", b"\xff\xfe\x00", b"null", b'{"name": 1}', b"x" * (HANDED_OVER_MAX_BYTES + 1)]
)
def test_what_is_neither_certificate_nor_entry_is_refused(tmp_path: Path, data: bytes) -> None:
    assert refusal(tmp_path / "file", data) == "FILE_UNUSABLE"
    with pytest.raises(BlockRobotError, match="FILE_UNUSABLE"):
        read_certificate(tmp_path / "file")


def test_more_certificates_than_the_contract_takes_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "many.pem"
    path.write_text(OLD.certificate_pem * 10, "utf-8")
    with pytest.raises(BlockRobotError, match="FILE_UNUSABLE"):
        read_authority_certificates(path)


def test_a_new_organisation_has_an_entry_without_any_of_its_secrets(tmp_path: Path) -> None:
    authority, made = create_organisation(tmp_path, "clinic")
    folder = tmp_path / "organisations" / "clinic"
    entry = folder / ORGANISATION_ENTRY_FILE
    assert read_organisation_entry(entry) == {
        "name": "clinic",
        "ca_certificate": authority.certificate_pem,
        "admins": list(made.admins),
        "registrars": list(made.registrars),
    }
    text = entry.read_text("utf-8")
    for name in ("admin.key", "registrar.key"):
        assert (folder / name).read_bytes().hex() not in text
    assert "PRIVATE" not in text
    assert set(json.loads(text)) == {"name", "ca_certificate", "admins", "registrars", "proofs"}


@pytest.mark.parametrize("name", ["../evil", "UPPER!", "", "a/b", "..", "x" * 41])
def test_an_organisation_cannot_be_named_out_of_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        create_organisation(tmp_path / "network", name)
    assert not any(tmp_path.rglob("*"))


@pytest.mark.parametrize("change", [{"admins": None}, {"admins": ["zz"]}, {"name": 7}, {"ca_certificate": "none"}])
def test_an_entry_that_is_not_whole_is_refused(tmp_path: Path, change: dict[str, object]) -> None:
    create_organisation(tmp_path, "clinic")
    path = tmp_path / "organisations" / "clinic" / ORGANISATION_ENTRY_FILE
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | change), "utf-8")
    with pytest.raises(BlockRobotError, match="FILE_UNUSABLE"):
        read_organisation_entry(path)
