"""Identifies a peer by certificate and directory; TLS checks only the CA chain, no dates."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from functools import lru_cache

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from consensus.errors import BlockRobotError
from node.directory.node_directory import DirectoryContent, DirectoryNode
from pages.time_format import format_utc_time

PROVEN_REFUSALS = frozenset({"PEER_CUT_OFF", "PEER_REMOVED", "PEER_CERTIFICATE_REVOKED", "PEER_CERTIFICATE_EXPIRED"})
"""Refusals of certificates that the CA of the named node's organisation did issue: their holders may be told why."""
UNREADABLE = (
    ValueError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.ExtensionNotFound,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
)
"""What reading a certificate of somebody's, or its extensions, may raise."""


@dataclass(frozen=True, slots=True)
class CertificateFacts:
    """A certificate's name, serial number, and validity (ms, UTC)."""

    name: str
    organisation: str
    serial: int
    not_before_ms: int
    not_after_ms: int

    @property
    def serial_hex(self) -> str:
        return f"{self.serial:x}"

    def is_expired(self, now_ms: int) -> bool:
        return now_ms > self.not_after_ms

    @property
    def expires(self) -> str:
        return format_utc_time(self.not_after_ms)


def read_facts(certificate: x509.Certificate | x509.CertificateSigningRequest) -> CertificateFacts:
    """An ambiguous name counts as none. A request has no number and no dates: 0."""

    def only(oid: x509.ObjectIdentifier) -> str:
        found = certificate.subject.get_attributes_for_oid(oid)
        return str(found[0].value) if len(found) == 1 else ""

    if isinstance(certificate, x509.CertificateSigningRequest):
        return CertificateFacts(only(NameOID.COMMON_NAME), only(NameOID.ORGANIZATION_NAME), 0, 0, 0)
    return CertificateFacts(
        name=only(NameOID.COMMON_NAME),
        organisation=only(NameOID.ORGANIZATION_NAME),
        serial=certificate.serial_number,
        not_before_ms=round(certificate.not_valid_before_utc.timestamp() * 1000),
        not_after_ms=round(certificate.not_valid_after_utc.timestamp() * 1000),
    )


@lru_cache(maxsize=256)
def load_authorities(ca_certificate: str) -> tuple[x509.Certificate, ...]:
    """Return an organisation's CA certificates (PEM, two allow rotation).

    An unusable one isolates only its own organisation's nodes.
    """
    try:
        found = x509.load_pem_x509_certificates(ca_certificate.encode())
    except UNREADABLE:
        return ()
    return tuple(certificate for certificate in found if _is_readable(certificate))


def _is_readable(certificate: x509.Certificate) -> bool:
    """Return whether both libraries take its names and key; they differ on oddities."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cadata=certificate.public_bytes(Encoding.DER))
        return all((certificate.subject, certificate.issuer, certificate.public_key()))
    except (ssl.SSLError, *UNREADABLE):
        return False


def identify_peer(certificate_der: bytes | None, directory: DirectoryContent, now_ms: int) -> CertificateFacts:
    """Return the facts of a network node's certificate, proving its name.

    Raises PEER_REFUSED (none, unreadable, unknown name), PEER_CERTIFICATE_FOREIGN (other CA), PEER_REMOVED,
    PEER_CERTIFICATE_REVOKED, PEER_CERTIFICATE_EXPIRED; `context["peer"]`: claimed name.
    """
    if not certificate_der:
        raise BlockRobotError("PEER_REFUSED", "The peer showed no certificate.")
    try:
        certificate = x509.load_der_x509_certificate(certificate_der)
        facts = read_facts(certificate)
    except UNREADABLE:
        raise BlockRobotError("PEER_REFUSED", "The peer's certificate cannot be read.") from None
    node = directory.nodes.get(facts.name)
    if node is None:
        raise _refused(
            "PEER_REFUSED", facts, f"The certificate names {facts.name!r}, which is no node of this network."
        )
    _require_issuer(certificate, facts, node, directory)
    if not directory.is_active(node):
        raise _refused("PEER_REMOVED", facts, f"{facts.name!r} was removed from the network.")
    if (node.organisation, facts.serial) in directory.revoked:
        raise _refused(
            "PEER_CERTIFICATE_REVOKED",
            facts,
            f"The certificate {facts.serial_hex} of {facts.name!r} was revoked by {node.organisation!r}.",
        )
    _require_dates(facts, now_ms)
    return facts


def _require_issuer(
    certificate: x509.Certificate, facts: CertificateFacts, node: DirectoryNode, directory: DirectoryContent
) -> None:
    organisation = directory.organisations.get(node.organisation)
    authorities = () if organisation is None else load_authorities(organisation.ca_certificate)
    if not any(_is_issued_by(certificate, authority) for authority in authorities):
        raise _refused(
            "PEER_CERTIFICATE_FOREIGN",
            facts,
            f"The certificate of {facts.name!r} is not from its organisation {node.organisation!r}.",
        )


def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


def _require_dates(facts: CertificateFacts, now_ms: int) -> None:
    if facts.is_expired(now_ms):
        detail = f"The certificate of {facts.name!r} expired on {facts.expires}."
        raise _refused("PEER_CERTIFICATE_EXPIRED", facts, detail)
    if now_ms < facts.not_before_ms:
        since = format_utc_time(facts.not_before_ms)
        detail = f"The certificate of {facts.name!r} counts from {since} on: is a clock wrong?"
        raise _refused("PEER_CERTIFICATE_EXPIRED", facts, detail)


def _refused(code: str, facts: CertificateFacts, detail: str) -> BlockRobotError:
    return BlockRobotError(code, detail, peer=facts.name)
