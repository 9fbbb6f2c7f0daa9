"""Checks certificate authorities before an organisation is bound to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import NameOID

from consensus.chain.genesis import Organisation
from consensus.errors import BlockRobotError
from consensus.state.membership import OrganisationRow
from node.p2p.identity import UNREADABLE, load_authorities

_OWNER_FIELDS = {"add_org": "name", "replace_ca": "organisation"}


def check_authority_change(kind: str, arguments: Mapping[str, Any], organisations: Iterable[OrganisationRow]) -> None:
    """Reject a proposal with an invalid or foreign authority. Raises AUTHORITY_INVALID."""
    if kind in _OWNER_FIELDS:
        check_authority(arguments["ca_certificate"], arguments[_OWNER_FIELDS[kind]], organisations)


def check_authority(ca_certificate: str, owner: str, organisations: Iterable[OrganisationRow | Organisation]) -> None:
    """Reject certificates (PEM) unfit as `owner`'s authority. Raises AUTHORITY_INVALID.

    Each has to be a CA, with a key of no other organisation's authority and no other organisation's name in its
    subject. TLS libraries tell authorities apart by subject and key identifier alone: no two organisations share these.
    """
    found = load_authorities(ca_certificate)
    if not found:
        raise BlockRobotError("AUTHORITY_INVALID", f"What is to be the authority of {owner} is no certificate.")
    others = [row for row in organisations if row.name != owner]
    theirs = [(row.name, item) for row in others for item in load_authorities(row.ca_certificate)]
    keys = {_key_of(item): name for name, item in theirs}
    looks = {look: name for name, item in theirs for look in _looks_of(item)}
    names = {row.name for row in others}
    for certificate in found:
        subject = certificate.subject.rfc4514_string()
        if not _may_sign(certificate):
            raise BlockRobotError("AUTHORITY_INVALID", f"The certificate {subject!r} is not that of an authority.")
        named = {item.value for item in certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATION_NAME)}
        holder = keys.get(_key_of(certificate)) or next((name for name in sorted(names) if name in named), None)
        if holder is not None:
            detail = f"The certificate {subject!r} is that of {holder}, not of {owner}."
            raise BlockRobotError("AUTHORITY_INVALID", detail)
        alike = next((looks[look] for look in _looks_of(certificate) if look in looks), None)
        if alike is not None:
            detail = f"The certificate {subject!r} of {owner} has the subject or key identifier of one of {alike}'s."
            raise BlockRobotError("AUTHORITY_INVALID", detail)


def fingerprints(ca_certificate: str) -> list[str]:
    """SHA-256 of each certificate (PEM), as `openssl x509 -fingerprint -sha256` shows it, in small letters."""
    return [certificate.fingerprint(hashes.SHA256()).hex() for certificate in load_authorities(ca_certificate)]


def _looks_of(certificate: x509.Certificate) -> list[object]:
    """By what TLS libraries find it; they tell neither small letters from capitals nor one blank from several."""
    subject = [
        frozenset((item.oid, " ".join(str(item.value).lower().split())) for item in part)
        for part in certificate.subject.rdns
    ]
    try:
        identifier = certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value.digest
    except UNREADABLE:
        return [tuple(subject)]
    return [tuple(subject), identifier]


def _key_of(certificate: x509.Certificate) -> bytes:
    """Return the public key (DER); if unreadable, the certificate itself."""
    try:
        return certificate.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    except UNREADABLE:
        return certificate.public_bytes(Encoding.DER)


def _may_sign(certificate: x509.Certificate) -> bool:
    try:
        extensions = certificate.extensions
        basic = extensions.get_extension_for_class(x509.BasicConstraints).value
    except UNREADABLE:
        return False
    try:
        usage = extensions.get_extension_for_class(x509.KeyUsage).value
    except x509.ExtensionNotFound:
        return basic.ca
    return basic.ca and usage.key_cert_sign
