"""A certificate proves a name only by the authority of that node's own organisation, and only while it counts."""

from __future__ import annotations

import datetime as dt

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import Authority, create_authority, issue_node_certificate
from node.directory.node_directory import DirectoryContent, DirectoryNode, DirectoryOrganisation
from node.p2p.identity import PROVEN_REFUSALS, identify_peer, load_authorities, read_facts

NOW = dt.datetime(2026, 6, 1, tzinfo=dt.UTC)
NOW_MS = round(NOW.timestamp() * 1000)
DAY_MS = 24 * 3600 * 1000


@pytest.fixture(scope="module")
def authorities() -> dict[str, Authority]:
    return {name: create_authority(name) for name in ("hospital", "university")}


def directory(authorities: dict[str, Authority], **changes: object) -> DirectoryContent:
    node = DirectoryNode("n1", "hospital", "127.0.0.1", 7001, "http://127.0.0.1:7002", b"", b"")
    fields: dict[str, object] = {
        "height": 5,
        "nodes": {"n1": node},
        "organisations": {
            name: DirectoryOrganisation(name, authority.certificate_pem) for name, authority in authorities.items()
        },
        "revoked": frozenset(),
    }
    return DirectoryContent(**(fields | changes))  # type: ignore[arg-type]


def certificate(authority: Authority, name: str = "n1", days: float = 30) -> bytes:
    issued = issue_node_certificate(authority, name, lifetime=dt.timedelta(days=days), now=NOW)
    return x509.load_pem_x509_certificate(issued.certificate_pem).public_bytes(Encoding.DER)


def refusal(der: bytes | None, content: DirectoryContent, now_ms: int = NOW_MS) -> str:
    with pytest.raises(BlockRobotError) as caught:
        identify_peer(der, content, now_ms)
    return caught.value.code


def test_a_node_is_known_by_a_certificate_of_its_own_organisation_alone(authorities: dict[str, Authority]) -> None:
    facts = identify_peer(certificate(authorities["hospital"]), directory(authorities), NOW_MS)
    assert (facts.name, facts.organisation) == ("n1", "hospital")
    assert facts.not_after_ms == NOW_MS + 30 * DAY_MS
    assert refusal(None, directory(authorities)) == "PEER_REFUSED"
    assert refusal(b"\x30\x03nonsense", directory(authorities)) == "PEER_REFUSED"
    assert refusal(certificate(authorities["hospital"], "n9"), directory(authorities)) == "PEER_REFUSED"
    assert refusal(certificate(authorities["university"]), directory(authorities)) == "PEER_CERTIFICATE_FOREIGN"
    foreign = create_authority("hospital")
    assert refusal(certificate(foreign), directory(authorities)) == "PEER_CERTIFICATE_FOREIGN"


def test_a_certificate_is_no_authority(authorities: dict[str, Authority]) -> None:
    """Whoever holds a node's key cannot certify other nodes with it."""
    stolen = issue_node_certificate(authorities["hospital"], "n1", now=NOW)
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    key = load_pem_private_key(stolen.key_pem, None)
    assert isinstance(key, EllipticCurvePrivateKey)
    false = Authority("hospital", x509.load_pem_x509_certificate(stolen.certificate_pem), key)
    assert refusal(certificate(false), directory(authorities)) == "PEER_CERTIFICATE_FOREIGN"


def test_a_removed_node_or_organisation_is_refused_by_that_name(authorities: dict[str, Authority]) -> None:
    der = certificate(authorities["hospital"])
    gone = DirectoryNode("n1", "hospital", "127.0.0.1", 7001, "", b"", b"", is_active=False)
    assert refusal(der, directory(authorities, nodes={"n1": gone})) == "PEER_REMOVED"
    pem = authorities["hospital"].certificate_pem
    left = {"hospital": DirectoryOrganisation("hospital", pem, is_active=False)}
    assert refusal(der, directory(authorities, organisations=left)) == "PEER_REMOVED"


def test_a_revoked_serial_counts_no_more_but_another_one_does(authorities: dict[str, Authority]) -> None:
    first, second = certificate(authorities["hospital"]), certificate(authorities["hospital"])
    serial = read_facts(x509.load_der_x509_certificate(first)).serial
    content = directory(authorities, revoked=frozenset({("hospital", serial)}))
    assert refusal(first, content) == "PEER_CERTIFICATE_REVOKED"
    assert identify_peer(second, content, NOW_MS).name == "n1"
    elsewhere = directory(authorities, revoked=frozenset({("university", serial)}))
    assert identify_peer(first, elsewhere, NOW_MS).serial == serial


@pytest.mark.parametrize(("offset_days", "counts"), [(29, True), (31, False), (-1, True), (-3, False)])
def test_a_certificate_counts_between_its_dates(
    authorities: dict[str, Authority], offset_days: int, *, counts: bool
) -> None:
    """A day of grace before: the clocks of two machines differ."""
    der, now_ms = certificate(authorities["hospital"]), NOW_MS + offset_days * DAY_MS
    if counts:
        assert identify_peer(der, directory(authorities), now_ms).name == "n1"
    else:
        assert refusal(der, directory(authorities), now_ms) == "PEER_CERTIFICATE_EXPIRED"


def test_a_stranger_is_never_told_why() -> None:
    assert {"PEER_REFUSED", "PEER_CERTIFICATE_FOREIGN"}.isdisjoint(PROVEN_REFUSALS)


def test_an_organisation_may_have_two_authorities_while_it_goes_over_to_a_new_one(
    authorities: dict[str, Authority],
) -> None:
    old, new = authorities["hospital"], create_authority("hospital")
    both = {"hospital": DirectoryOrganisation("hospital", old.certificate_pem + new.certificate_pem)}
    content = directory(authorities, organisations=both)
    for authority in (old, new):
        assert identify_peer(certificate(authority), content, NOW_MS).name == "n1"
    assert refusal(certificate(authorities["university"]), content) == "PEER_CERTIFICATE_FOREIGN"


def test_an_authority_that_cannot_be_read_is_none(authorities: dict[str, Authority]) -> None:
    assert load_authorities("-----BEGIN CERTIFICATE-----\nrubbish") == ()
    broken = {"hospital": DirectoryOrganisation("hospital", "rubbish")}
    content = directory(authorities, organisations=broken)
    assert refusal(certificate(authorities["hospital"]), content) == "PEER_CERTIFICATE_FOREIGN"
