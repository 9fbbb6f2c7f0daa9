"""Whatever PEM text the organisations agreed on, a node starts, and trusts everybody whose certificate can be read."""

from __future__ import annotations

import contextlib
import ssl
import sys
import textwrap
from base64 import b64encode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import Authority, create_authority, issue_node_certificate
from node.directory.node_directory import DirectoryContent, DirectoryOrganisation
from node.p2p.identity import load_authorities
from node.p2p.tls import Credentials, pass_over_strange_names

OWN = create_authority("hospital")
OTHER = create_authority("clinic")
LAST = create_authority("university")


def pem(der: bytes, *headers: str, width: int = 64, label: str = "CERTIFICATE") -> str:
    """Write bytes as PEM, in whatever shape is asked for."""
    body = textwrap.wrap(b64encode(der).decode(), width)
    middle = [*headers, ""] if headers else []
    return "\n".join([f"-----BEGIN {label}-----", *middle, *body, f"-----END {label}-----"])


DER = OTHER.certificate.public_bytes(Encoding.DER)
ODD: dict[str, str] = {
    "no line end": OTHER.certificate_pem.rstrip("\n"),
    "windows line ends": OTHER.certificate_pem.replace("\n", "\r\n"),
    "old line ends": OTHER.certificate_pem.replace("\n", "\r"),
    "spaces behind lines": OTHER.certificate_pem.replace("\n", "  \n"),
    "headers": pem(DER, "Proc-Type: 4,CLEAR", "Comment: ours"),
    "one long line": pem(DER, width=8_000),
    "very short lines": pem(DER, width=5),
    "words behind": OTHER.certificate_pem + "this is our authority",
    "words between": OTHER.certificate_pem + "and\n" + OTHER.certificate_pem,
    "twice": OTHER.certificate_pem * 2,
    "two on one line": OTHER.certificate_pem.rstrip("\n") + OTHER.certificate_pem,
    "another label": pem(DER, label="X509 CERTIFICATE"),
    "trusted label": pem(DER, label="TRUSTED CERTIFICATE"),
    "a key behind": OTHER.certificate_pem + pem(b"\x30\x03\x02\x01\x00", label="PRIVATE KEY"),
    "cut short": OTHER.certificate_pem[:200],
    "no certificate in it": pem(b"\x30\x03\x02\x01\x00"),
    "not base64": "-----BEGIN CERTIFICATE-----\n!!!!\n-----END CERTIFICATE-----\n",
    "bytes behind": pem(DER + b"\0\0"),
    "a version that is none": pem(DER.replace(b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x07", 1)),
    "only the first line": "-----BEGIN CERTIFICATE-----",
    "a subject that is no text": pem(DER.replace(b"\x0c\x06clinic", b"\x00\x06clinic")),
    "a zero byte": OTHER.certificate_pem + "\0",
    "nothing": "",
}


@pytest.fixture(scope="module")
def open_credentials(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Credentials]:
    folder = tmp_path_factory.mktemp("tls")
    issued = issue_node_certificate(OWN, "node-1")
    certificate: Path = folder / "tls.crt.pem"
    key: Path = folder / "tls.key.pem"
    certificate.write_bytes(issued.certificate_pem)
    key.write_bytes(issued.key_pem)
    return lambda text: Credentials(certificate, key, directory(text))


def directory(clinic: str) -> DirectoryContent:
    """The clinic stands before the others, so that its text would spoil what comes behind."""
    texts = {"clinic": clinic, "hospital": OWN.certificate_pem, "university": LAST.certificate_pem}
    return DirectoryContent(7, {}, {name: DirectoryOrganisation(name, text) for name, text in texts.items()})


def trusted(context: ssl.SSLContext) -> set[bytes]:
    return set(context.get_ca_certs(binary_form=True))


@pytest.mark.parametrize("kind", ODD)
def test_an_odd_certificate_of_one_organisation_harms_no_other(
    kind: str, open_credentials: Callable[[str], Credentials]
) -> None:
    credentials = open_credentials(ODD[kind])
    others = {authority.certificate.public_bytes(Encoding.DER) for authority in (OWN, LAST)}
    assert others <= trusted(credentials.accepting)
    assert all(trusted(credentials.dialling(name)) <= others for name in ("hospital", "university"))
    assert others == trusted(credentials.dialling("hospital")) | trusted(credentials.dialling("university"))


@pytest.mark.parametrize(
    "kind", ["no line end", "windows line ends", "headers", "one long line", "words behind", "twice", "another label"]
)
def test_what_can_be_read_is_trusted_however_it_is_written(
    kind: str, open_credentials: Callable[[str], Credentials]
) -> None:
    assert load_authorities(ODD[kind])
    assert DER in trusted(open_credentials(ODD[kind]).accepting)


@pytest.mark.parametrize("kind", ODD)
def test_an_odd_certificate_that_comes_while_the_node_runs_harms_no_other(
    kind: str, open_credentials: Callable[[str], Credentials]
) -> None:
    credentials = open_credentials(OTHER.certificate_pem)
    assert trusted(credentials.dialling("clinic")) == {DER}
    credentials.trust(directory(ODD[kind]))
    assert trusted(credentials.dialling("clinic")) <= {DER}
    assert LAST.certificate.public_bytes(Encoding.DER) in trusted(credentials.accepting)
    assert trusted(credentials.dialling("university")) == {LAST.certificate.public_bytes(Encoding.DER)}


def test_the_same_certificate_written_otherwise_is_no_change(open_credentials: Callable[[str], Credentials]) -> None:
    credentials = open_credentials(OTHER.certificate_pem)
    assert not credentials.trust(directory(ODD["windows line ends"]))
    assert credentials.trust(directory(ODD["cut short"]))


def test_without_any_readable_authority_the_node_says_so(open_credentials: Callable[[str], Credentials]) -> None:
    credentials = open_credentials(OTHER.certificate_pem)
    nobody = DirectoryContent(8, {}, {"clinic": DirectoryOrganisation("clinic", ODD["cut short"])})
    with pytest.raises(BlockRobotError, match=r"^GENESIS_INVALID:"):
        credentials.trust(nobody)
    assert DER in trusted(credentials.accepting)


def test_only_active_organisations_vouch_for_who_does_not_say_whose_it_is(
    open_credentials: Callable[[str], Credentials],
) -> None:
    """A removed one's certificates are looked at for its own nodes, which are told why they count no more."""
    credentials, known = open_credentials(OTHER.certificate_pem), directory(OTHER.certificate_pem)
    removed = {**known.organisations, "clinic": replace(known.organisations["clinic"], is_active=False)}
    assert DER in trusted(credentials.accepting)
    assert credentials.trust(replace(known, organisations=removed))
    assert DER not in trusted(credentials.accepting)
    assert shake_hands(credentials, OTHER, "clinic") == "shaken"
    assert shake_hands(credentials, OTHER, "hospital") == "CERTIFICATE_VERIFY_FAILED"
    assert shake_hands(credentials, OTHER, None) == "CERTIFICATE_VERIFY_FAILED"


def shake_hands(credentials: Credentials, authority: Authority, said: str | None, sent: bytes = b"") -> str:
    """Dial a node, in memory, with a certificate of an authority; `sent`: what goes over the line in place of `said`."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    issued = issue_node_certificate(authority, "node-2")
    with TemporaryDirectory() as folder:
        certificate, key = Path(folder, "crt"), Path(folder, "key")
        certificate.write_bytes(issued.certificate_pem)
        key.write_bytes(issued.key_pem)
        context.load_cert_chain(certificate, key)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = context.wrap_bio(to_client, to_server, server_hostname=said)
    server = credentials.accepting.wrap_bio(to_server, to_client, server_side=True)
    with pytest.raises(ssl.SSLWantReadError):
        client.do_handshake()
    if sent:
        hello = to_server.read()
        assert said is not None
        assert hello.count(said.encode()) == 1
        to_server.write(hello.replace(said.encode(), sent))
    try:
        with contextlib.suppress(ssl.SSLWantReadError):
            server.do_handshake()
        client.do_handshake()
        server.do_handshake()
    except ssl.SSLError as error:
        return str(error.reason)
    return "shaken"


def test_a_name_that_cannot_be_read_ends_the_handshake_and_is_not_told(
    open_credentials: Callable[[str], Credentials], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stranger could fill a disk with it."""
    monkeypatch.setattr(sys, "unraisablehook", pass_over_strange_names)
    credentials = open_credentials(OTHER.certificate_pem)
    assert shake_hands(credentials, OTHER, "clinic") == "shaken"
    assert shake_hands(credentials, OTHER, "clinic", b"\xff" * 6) == "CALLBACK_FAILED"
    assert capsys.readouterr().err == ""
