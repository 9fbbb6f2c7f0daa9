"""Files exchanged between a network's parties.

Proposals are public for ever: certificates and entries are re-encoded from parsed data, and files with a private key
rejected.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from clients.sdk.new_files import read_given_file
from consensus.bounded_text import read_json_text
from consensus.chain.genesis import NodeEntry
from consensus.errors import BlockRobotError
from consensus.primitives.keys import is_public_key
from node.p2p.identity import UNREADABLE, load_authorities

ORGANISATION_ENTRY_FILE = "organisation-entry.json"
HANDED_OVER_MAX_BYTES = 256 * 1024
CERTIFICATES_MAX_CHARS = 4096
"""As the contract has it: an organisation's certificates together."""


def read_public_text(path: Path) -> str:
    """Raises FILE_HOLDS_PRIVATE_KEY, FILE_UNUSABLE."""
    data = read_given_file(path, HANDED_OVER_MAX_BYTES)
    if b"PRIVATE KEY" in data:
        raise BlockRobotError("FILE_HOLDS_PRIVATE_KEY", f"{path} holds a private key; nothing of it was sent.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is no text file.") from None


def public_certificates(text: str, place: Path) -> str:
    """Re-encoded as PEM alone. Raises FILE_UNUSABLE."""
    found = load_authorities(text)
    if not found:
        raise BlockRobotError("FILE_UNUSABLE", f"{place} holds no certificate in PEM that can be used.")
    written = "".join(certificate.public_bytes(Encoding.PEM).decode() for certificate in found)
    if len(written) > CERTIFICATES_MAX_CHARS:
        detail = f"The certificates in {place} are longer than {CERTIFICATES_MAX_CHARS} characters together."
        raise BlockRobotError("FILE_UNUSABLE", detail)
    return written


def read_authority_certificates(path: Path) -> str:
    """Raises FILE_HOLDS_PRIVATE_KEY, FILE_UNUSABLE."""
    return public_certificates(read_public_text(path), path)


def read_certificate(path: Path) -> x509.Certificate:
    """Raises FILE_UNUSABLE."""
    try:
        return x509.load_pem_x509_certificate(read_given_file(path, HANDED_OVER_MAX_BYTES))
    except UNREADABLE:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is no certificate in PEM.") from None


def _require_public_keys(keys: list[bytes], path: Path) -> None:
    """Reject keys without a possible secret key: they count but never sign. Raises FILE_UNUSABLE."""
    if not all(is_public_key(key) for key in keys):
        raise BlockRobotError("FILE_UNUSABLE", f"A key in {path} is no public key.")


def read_organisation_entry(path: Path) -> dict[str, Any]:
    """As proposal arguments. Raises FILE_HOLDS_PRIVATE_KEY, FILE_UNUSABLE."""
    text = read_public_text(path)
    try:
        document = read_json_text(text)
        name, certificate = document["name"], document["ca_certificate"]
        keys = {kind: [bytes.fromhex(key) for key in document[kind]] for kind in ("admins", "registrars")}
    except (ValueError, TypeError, KeyError):
        raise BlockRobotError("FILE_UNUSABLE", f"{path} does not hold an organisation's entry.") from None
    _require_public_keys([key for kind in keys.values() for key in kind], path)
    if not isinstance(name, str) or not isinstance(certificate, str):
        raise BlockRobotError("FILE_UNUSABLE", f"{path} does not hold an organisation's entry.")
    return {"name": name, "ca_certificate": public_certificates(certificate, path), **keys}


def read_node_entry(path: Path) -> dict[str, Any]:
    """The genesis file's node fields as JSON, keys in hex.

    Raises FILE_HOLDS_PRIVATE_KEY, FILE_UNUSABLE.
    """
    text = read_public_text(path)
    try:
        document = read_json_text(text)
        fields = {name: document[name] for name in NodeEntry.__struct_fields__}
        for name in ("producer_key", "producer_possession", "custodian_key"):
            fields[name] = bytes.fromhex(fields[name])
    except (ValueError, TypeError, KeyError):
        raise BlockRobotError("FILE_UNUSABLE", f"{path} does not hold a node's entry.") from None
    _require_public_keys([key for key in (fields["producer_key"], fields["custodian_key"]) if key], path)
    return fields
