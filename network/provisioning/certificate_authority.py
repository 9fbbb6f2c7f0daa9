"""Organisations' certificate authorities and their nodes' certificates.

Keys are ECDSA P-256; a node's certificate has its name as common name.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from consensus.errors import BlockRobotError
from node.config import LOOPBACK
from node.p2p.identity import UNREADABLE

AUTHORITY_KEY_FILE, AUTHORITY_CERTIFICATE_FILE = "ca.key.pem", "ca.crt.pem"
AUTHORITY_LIFETIME_DAYS = 10 * 365
NODE_LIFETIME_DAYS = 2 * 365
_BACKDATED_HOURS = 25  # so that a node whose clock is a day behind takes a new certificate too


@dataclass(frozen=True, slots=True)
class Authority:
    """An organisation's CA certificate and private key."""

    organisation: str
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @property
    def certificate_pem(self) -> str:
        return self.certificate.public_bytes(serialization.Encoding.PEM).decode()


@dataclass(frozen=True, slots=True)
class NodeCertificate:
    """A node's TLS certificate and key (PEM), and serial number."""

    certificate_pem: bytes
    key_pem: bytes
    serial: int


def subject_of(organisation: str, common_name: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, organisation),
            x509.NameAttribute(NameOID.COMMON_NAME, common_name),
        ]
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, lifetime: dt.timedelta, now: dt.datetime | None = None
) -> x509.CertificateBuilder:
    now = now or dt.datetime.now(dt.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(hours=_BACKDATED_HOURS))
        .not_valid_after(now + lifetime)
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def create_authority(organisation: str) -> Authority:
    key = ec.generate_private_key(ec.SECP256R1())
    name = subject_of(organisation, f"{organisation} node authority")
    certificate = (
        _builder(name, name, dt.timedelta(days=AUTHORITY_LIFETIME_DAYS))
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return Authority(organisation=organisation, certificate=certificate, key=key)


def load_authority(folder: Path, organisation: str = "") -> Authority:
    """The name defaults to the folder's. Raises FILE_UNUSABLE."""
    try:
        key = serialization.load_pem_private_key((folder / AUTHORITY_KEY_FILE).read_bytes(), None)
        certificate = x509.load_pem_x509_certificate((folder / AUTHORITY_CERTIFICATE_FILE).read_bytes())
    except (TypeError, *UNREADABLE):
        raise BlockRobotError("FILE_UNUSABLE", f"The authority in {folder} cannot be read.") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        detail = f"The authority's key in {folder} is not of an elliptic curve: its own programs sign requests"
        raise BlockRobotError("FILE_UNUSABLE", f"{detail} (blockrobot certificate request).")
    if key.public_key() != certificate.public_key():
        raise BlockRobotError("FILE_UNUSABLE", f"The authority's key in {folder} is not that of its certificate.")
    return Authority(organisation=organisation or folder.name, certificate=certificate, key=key)


def _address(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def host_names(hosts: Sequence[str]) -> list[x509.GeneralName]:
    """Addresses as a certificate names them, each once."""
    return [_address(host) for host in dict.fromkeys(hosts)]


def issue_node_certificate(
    authority: Authority,
    node: str,
    *hosts: str,
    lifetime: dt.timedelta = dt.timedelta(days=NODE_LIFETIME_DAYS),
    key: ec.EllipticCurvePrivateKey | None = None,
    now: dt.datetime | None = None,
) -> NodeCertificate:
    """Issue a certificate: common and DNS name `node`, reached at `hosts` (IP or name; else 127.0.0.1).

    Valid until `now` + `lifetime`; for `key`, else a new one.
    """
    key = key or ec.generate_private_key(ec.SECP256R1())
    certificate = certify(authority, node, hosts or (LOOPBACK,), key.public_key(), lifetime, now)
    return NodeCertificate(
        certificate_pem=certificate.public_bytes(serialization.Encoding.PEM),
        key_pem=encode_private_key(key),
        serial=certificate.serial_number,
    )


def certify(
    authority: Authority,
    node: str,
    hosts: Sequence[str],
    key: ec.EllipticCurvePublicKey,
    lifetime: dt.timedelta,
    now: dt.datetime | None = None,
) -> x509.Certificate:
    """As `issue_node_certificate`, for a key whose other half is elsewhere."""
    names = [x509.DNSName(node), *host_names(hosts)]
    try:
        named = authority.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
        issuer_key = x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(named)
    except x509.ExtensionNotFound:
        issuer_key = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key())
    return (
        _builder(subject_of(authority.organisation, node), authority.certificate.subject, lifetime, now)
        .public_key(key)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False
        )
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
        .add_extension(issuer_key, critical=False)
        .sign(authority.key, hashes.SHA256())
    )


def certified_hosts(certificate: x509.Certificate | x509.CertificateSigningRequest) -> tuple[str, ...]:
    """Where a certificate, or a request for one, says its node is reached, besides by its name. Raises `UNREADABLE`."""
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    names = [name for name in found if isinstance(name, x509.DNSName | x509.IPAddress)]
    own = {str(name.value) for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)}
    return tuple(text for text in (str(name.value) for name in names) if text not in own)


def encode_private_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    """As unencrypted PKCS#8 PEM."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def write_secret(path: Path, data: bytes) -> None:
    """With mode 0600. Raises FileExistsError, never overwrites."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
