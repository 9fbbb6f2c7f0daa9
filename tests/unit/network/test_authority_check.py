"""No organisation is bound to an authority that a TLS library could take for another organisation's."""

from __future__ import annotations

import contextlib
from base64 import b64encode
from hashlib import sha256

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from consensus.chain.genesis import Organisation
from consensus.errors import BlockRobotError
from network.provisioning.authority_check import check_authority, fingerprints
from network.provisioning.certificate_authority import Authority, create_authority
from tests.twin_authority import twin_of


def name_of(organisation: str, common_name: str) -> x509.Name:
    names = ((NameOID.ORGANIZATION_NAME, organisation), (NameOID.COMMON_NAME, common_name))
    return x509.Name([x509.NameAttribute(oid, value) for oid, value in names])


FRESH = x509.SubjectKeyIdentifier(b"of nobody")
HOUSE = twin_of(create_authority("hospital"), "hospital", subject=name_of("General Hospital Ltd", "Ward CA 2"))
"""An authority that a hospital has had for long: nothing in it says what the hospital is called in the network."""


def entry(name: str, *authorities: Authority) -> Organisation:
    return Organisation(name, "".join(each.certificate_pem for each in authorities), (), ())


@pytest.mark.parametrize(
    "twin",
    [
        twin_of(HOUSE, "evil"),
        twin_of(HOUSE, "evil", identifier=FRESH),
        twin_of(HOUSE, "evil", identifier=FRESH, subject=name_of(" general  hospital LTD", "ward ca 2 ")),
        twin_of(HOUSE, "evil", subject=name_of("evil", "Ward CA 2")),
    ],
    ids=["both", "its subject", "its subject, written otherwise", "its key identifier"],
)
def test_nobody_has_an_authority_that_looks_like_anothers(twin: Authority) -> None:
    parties = [entry("evil", create_authority("evil"), twin), entry("hospital", HOUSE)]
    for party, other in zip(parties, ("hospital", "evil"), strict=True):
        with pytest.raises(
            BlockRobotError, match=rf"^AUTHORITY_INVALID: .* of {party.name} has .* of one of {other}'s"
        ):
            check_authority(party.ca_certificate, party.name, parties)
    check_authority(HOUSE.certificate_pem, "hospital", [entry("evil", create_authority("evil"))])


def test_an_organisation_replaces_its_authority_by_one_of_the_same_name() -> None:
    old, new = create_authority("hospital"), create_authority("hospital")
    others = [entry("hospital", old), entry("evil", HOUSE)]
    check_authority(old.certificate_pem + new.certificate_pem, "hospital", others)


@pytest.mark.parametrize("tag", range(256))
def test_an_authority_whose_subject_is_damaged_is_none(tag: int) -> None:
    der = bytearray(HOUSE.certificate.public_bytes(Encoding.DER))
    der[der.rfind(b"\x0c\x09Ward CA 2")] = tag
    text = f"-----BEGIN CERTIFICATE-----\n{b64encode(der).decode()}\n-----END CERTIFICATE-----\n"
    with contextlib.suppress(BlockRobotError):
        check_authority(text, "hospital", [])
        fingerprints(text)


def test_what_is_shown_of_an_authority_is_the_usual_fingerprint() -> None:
    own = create_authority("hospital")
    digests = [sha256(each.certificate.public_bytes(Encoding.DER)).hexdigest() for each in (HOUSE, own)]
    assert fingerprints(entry("hospital", HOUSE, own).ca_certificate) == digests
