"""Certificates by request (PKCS #10, RFC 2986): a node's key stays where it is, and so does the authority's."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import Authority, certified_hosts, certify, host_names, subject_of
from node.config import NodeConfig
from node.directory.node_directory import DirectoryContent
from node.p2p.identity import UNREADABLE, identify_peer, read_facts
from node.p2p.tls import read_private_key


def make_request(config: NodeConfig, organisation: str, hosts: Sequence[str]) -> bytes:
    """Return a node's request, PEM, signed by the key that it has. Raises FILE_UNUSABLE."""
    key = read_private_key(config.tls_key_path)
    names = [x509.DNSName(config.name), *host_names(hosts)]
    request = (
        x509.CertificateSigningRequestBuilder()
        .subject_name(subject_of(organisation, config.name))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .sign(key, hashes.SHA256())
    )
    return request.public_bytes(Encoding.PEM)


def sign_request(authority: Authority, pem: bytes, days: int) -> x509.Certificate:
    """Issue what a request asks for: its key, its common name and its addresses, and nothing else.

    Raises FILE_UNUSABLE if it is no request, or of another organisation.
    """
    try:
        request = x509.load_pem_x509_csr(pem)
        facts, hosts = read_facts(request), certified_hosts(request)
        key, is_signed = request.public_key(), request.is_signature_valid
    except UNREADABLE:
        raise BlockRobotError(
            "FILE_UNUSABLE", "That is no certificate request in PEM, or one without addresses."
        ) from None
    if not is_signed or not isinstance(key, ec.EllipticCurvePublicKey):
        raise BlockRobotError("FILE_UNUSABLE", "The request is not signed by its own key, of an elliptic curve.")
    if facts.organisation != authority.organisation:
        detail = f"The request is of {facts.organisation!r}, not of {authority.organisation!r}."
        raise BlockRobotError("FILE_UNUSABLE", detail)
    try:
        return certify(authority, facts.name, hosts, key, dt.timedelta(days=days))
    except ValueError:
        detail = (
            f"The request names {facts.name!r}, which is no name of a node, or an address that no certificate can name."
        )
        raise BlockRobotError("FILE_UNUSABLE", detail) from None


def check_certificate(config: NodeConfig, pem: bytes, directory: DirectoryContent, now_ms: int) -> x509.Certificate:
    """Return the node's own certificate from a file that somebody signed.

    Raises FILE_UNUSABLE, PEER_CERTIFICATE_FOREIGN, PEER_CERTIFICATE_EXPIRED, PEER_CERTIFICATE_REVOKED, PEER_REFUSED.
    """
    try:
        certificate = x509.load_pem_x509_certificate(pem)
    except UNREADABLE:
        raise BlockRobotError("FILE_UNUSABLE", "That is no certificate in PEM.") from None
    if certificate.public_key() != read_private_key(config.tls_key_path).public_key():
        raise BlockRobotError("FILE_UNUSABLE", "The certificate is not for the key of this node: make a request anew.")
    facts = identify_peer(certificate.public_bytes(Encoding.DER), directory, now_ms)
    if facts.name != config.name:
        raise BlockRobotError("FILE_UNUSABLE", f"The certificate names {facts.name!r}, not {config.name!r}.")
    return certificate


def check_fit(certificate: x509.Certificate, names: Sequence[str]) -> None:
    """Whether peers and clients would take it for a node of these names. Raises CERTIFICATE_UNFIT."""
    try:
        named = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        missing = [name for name in host_names(names) if name not in named]
    except UNREADABLE:
        missing = host_names(names)
    if missing:
        shown = ", ".join(str(name.value) for name in missing)
        raise BlockRobotError("CERTIFICATE_UNFIT", f"The certificate does not name {shown}.")
    try:
        purposes = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return
    if not {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH} <= set(purposes):
        raise BlockRobotError("CERTIFICATE_UNFIT", "The certificate is not for servers and clients both.")
