"""Who is at the other end: TLS 1.3 with certificates on both sides. Must never accept a name without its own CA.

The TLS library checks that a certificate leads to some CA of the genesis file; `identify_peer` then checks that the
name in it is a node of the network and that the CA is that of the node's own organisation, so that one organisation
cannot pass for another's node.
"""

from __future__ import annotations

import ssl

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import NameOID

from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from node.config import NodeConfig


def _context(config: NodeConfig, genesis: Genesis, purpose: ssl.Purpose) -> ssl.SSLContext:
    authorities = "".join(organisation.ca_certificate for organisation in genesis.organisations)
    try:
        context = ssl.create_default_context(purpose, cadata=authorities)
    except (ssl.SSLError, ValueError):
        raise BlockRobotError("GENESIS_INVALID", "A CA certificate of the genesis file cannot be read.") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    try:
        context.load_cert_chain(config.tls_certificate_path, config.tls_key_path)
    except (ssl.SSLError, OSError):
        raise BlockRobotError("CONFIGURATION_INVALID", "The node's TLS certificate or key cannot be read.") from None
    return context


def server_context(config: NodeConfig, genesis: Genesis) -> ssl.SSLContext:
    """Return the context for accepted connections. Raises GENESIS_INVALID or CONFIGURATION_INVALID."""
    context = _context(config, genesis, ssl.Purpose.CLIENT_AUTH)
    context.num_tickets = 0
    return context


def client_context(config: NodeConfig, genesis: Genesis) -> ssl.SSLContext:
    """Return the context for dialled connections. Raises GENESIS_INVALID or CONFIGURATION_INVALID."""
    return _context(config, genesis, ssl.Purpose.SERVER_AUTH)


def identify_peer(certificate_der: bytes | None, genesis: Genesis) -> str:
    """Return the node's name that a certificate proves. Raises PEER_REFUSED."""
    if not certificate_der:
        raise BlockRobotError("PEER_REFUSED", "The peer showed no certificate.")
    certificate = x509.load_der_x509_certificate(certificate_der)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name = str(names[0].value) if len(names) == 1 else ""
    entry = next((node for node in genesis.nodes if node.name == name), None)
    if entry is None:
        raise BlockRobotError("PEER_REFUSED", f"The certificate names {name!r}, which is no node of this network.")
    organisation = next(item for item in genesis.organisations if item.name == entry.organisation)
    authority = x509.load_pem_x509_certificate(organisation.ca_certificate.encode())
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        raise BlockRobotError(
            "PEER_REFUSED", f"The certificate of {name!r} is not from its organisation {entry.organisation!r}."
        ) from None
    return name
