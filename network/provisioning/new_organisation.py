"""Makes an organisation's folder: its certificate authority, an admin's and a registrar's key, and its public entry."""

from __future__ import annotations

from pathlib import Path

from consensus.chain.genesis import Organisation
from consensus.errors import BlockRobotError
from network.provisioning.authority_check import check_authority
from network.provisioning.certificate_authority import (
    AUTHORITY_CERTIFICATE_FILE,
    AUTHORITY_KEY_FILE,
    Authority,
    create_authority,
    encode_private_key,
    write_secret,
)
from network.provisioning.exchange_files import ORGANISATION_ENTRY_FILE
from network.provisioning.founding_entries import organisation_entry_to_json
from network.provisioning.new_node import check_name, new_key

ADMIN_KEY_FILE = "admin.key"


def create_organisation(directory: Path, name: str) -> tuple[Authority, Organisation]:
    """Below `directory`/organisations. Raises ORGANISATION_EXISTS, CONFIGURATION_INVALID for an invalid name."""
    _check_free(directory, name)
    authority = create_authority(name)
    write_secret(directory / "organisations" / name / AUTHORITY_KEY_FILE, encode_private_key(authority.key))
    return authority, _write_organisation(directory, name, authority.certificate_pem)


def enter_organisation(directory: Path, name: str, ca_certificate: str) -> Organisation:
    """As `create_organisation`, with the certificate (PEM) of an authority elsewhere. Raises AUTHORITY_INVALID."""
    _check_free(directory, name)
    check_authority(ca_certificate, name, ())
    return _write_organisation(directory, name, ca_certificate)


def _check_free(directory: Path, name: str) -> None:
    check_name(name, "an organisation")
    folder = directory / "organisations" / name
    if folder.exists():
        raise BlockRobotError("ORGANISATION_EXISTS", f"There is an organisation in {folder} already.")


def _write_organisation(directory: Path, name: str, ca_certificate: str) -> Organisation:
    folder = directory / "organisations" / name
    admin, registrar = new_key(), new_key()
    write_secret(folder / ADMIN_KEY_FILE, admin.secret)
    write_secret(folder / "registrar.key", registrar.secret)
    (folder / AUTHORITY_CERTIFICATE_FILE).write_text(ca_certificate, encoding="utf-8")
    entry = Organisation(
        name=name,
        ca_certificate=ca_certificate,
        admins=(admin.public_key,),
        registrars=(registrar.public_key,),
    )
    text = organisation_entry_to_json(entry, (admin, registrar))
    (folder / ORGANISATION_ENTRY_FILE).write_text(text, encoding="utf-8")
    return entry
