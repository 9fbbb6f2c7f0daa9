"""An authority that is taken for another one where only names and key identifiers are compared."""

from __future__ import annotations

import datetime as dt

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from network.provisioning.certificate_authority import Authority


def twin_of(
    authority: Authority,
    owner: str,
    *,
    subject: x509.Name | None = None,
    identifier: x509.SubjectKeyIdentifier | None = None,
) -> Authority:
    """`owner`'s: subject and key identifier are the other one's, unless given; it has its own key and a longer life."""
    known, key, now = authority.certificate, ec.generate_private_key(ec.SECP256R1()), dt.datetime.now(dt.UTC)
    same = known.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject or known.subject)
        .issuer_name(subject or known.subject)
        .serial_number(known.serial_number)
        .not_valid_before(now - dt.timedelta(days=1))
        .not_valid_after(now + dt.timedelta(days=40 * 365))
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(identifier or same, critical=False)
        .sign(key, hashes.SHA256())
    )
    return Authority(owner, certificate, key)
