"""Makes an organisation's folder: its certificate authority, an admin's and a registrar's key, and its public entry."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

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
    return authority, _write_organisation(directory, name, authority.certificate_pem, encode_private_key(authority.key))


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


def _write_organisation(directory: Path, name: str, ca_certificate: str, ca_key: bytes | None = None) -> Organisation:
    """The whole folder, or nothing of it."""
    folder = directory / "organisations" / name
    admin, registrar = new_key(), new_key()
    entry = Organisation(
        name=name,
        ca_certificate=ca_certificate,
        admins=(admin.public_key,),
        registrars=(registrar.public_key,),
    )
    folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{name}.", dir=folder.parent) as own:
        making = Path(own, name)
        making.mkdir(mode=0o700)
        secrets = {AUTHORITY_KEY_FILE: ca_key, ADMIN_KEY_FILE: admin.secret, "registrar.key": registrar.secret}
        for file, secret in secrets.items():
            if secret is not None:
                write_secret(making / file, secret)
        (making / AUTHORITY_CERTIFICATE_FILE).write_text(ca_certificate, encoding="utf-8")
        text = organisation_entry_to_json(entry, (admin, registrar))
        (making / ORGANISATION_ENTRY_FILE).write_text(text, encoding="utf-8")
        making.rename(folder)
    return entry
