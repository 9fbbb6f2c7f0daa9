"""A certificate by request: no key leaves its machine, and what comes back is taken only if it fits the node."""

from __future__ import annotations

import datetime as dt
import json
import shlex
import ssl
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.x509.oid import NameOID

from clients.sdk import connections
from consensus.errors import BlockRobotError
from network.cli.node import certificate_commands
from network.cli.node.certificate_commands import certificate
from network.cli.node.node_setup_commands import init
from network.cluster import Cluster
from network.provisioning.certificate_authority import (
    Authority,
    certified_hosts,
    certify,
    create_authority,
    encode_private_key,
    host_names,
    load_authority,
    write_secret,
)
from network.provisioning.certificate_requests import check_certificate, make_request, sign_request
from network.provisioning.exchange_files import read_node_entry
from network.provisioning.network_layout import create_network
from network.provisioning.new_node import NODE_ENTRY_FILE
from network.provisioning.new_organisation import create_organisation
from network.provisioning.node_certificates import now_ms, read_report
from node.config import NodeConfig, load_config
from node.directory.directory_file import encode_directory
from node.directory.node_directory import DirectoryContent, DirectoryNode, content_of_genesis
from node.p2p.tls import Credentials, read_private_key


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    create_network(tmp_path / "network", nodes=2, organisations=2, base_port=20_000)
    return tmp_path / "network"


@pytest.fixture
def config(folder: Path) -> NodeConfig:
    return Cluster(folder).config("node-1")


@pytest.fixture
def authority(folder: Path) -> Authority:
    return load_authority(folder / "organisations" / "hospital")


@pytest.fixture
def directory(folder: Path) -> DirectoryContent:
    return content_of_genesis(Cluster(folder).genesis)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(certificate, list(arguments))


def pem_of(made: x509.Certificate) -> bytes:
    return made.public_bytes(serialization.Encoding.PEM)


def test_a_request_goes_and_a_certificate_comes_and_both_keys_stay(folder: Path, tmp_path: Path) -> None:
    config, away = Cluster(folder).config("node-1"), tmp_path / "authority"
    (folder / "organisations" / "hospital").rename(away)
    key, secrets = config.tls_key_path.read_bytes(), (away / "ca.key.pem").read_bytes()
    asked, made = tmp_path / "node-1.csr", tmp_path / "node-1.crt.pem"
    home = ("--dir", str(folder))
    hosts = ("--host", "127.0.0.1", "--host", "node-1.clinic.example")
    assert run("request", "node-1", "--out", str(asked), *hosts, *home).exit_code == 0
    said = run(
        *("sign", str(asked), "--organisation", "hospital", "--out", str(made), "--days", "90"),
        *("--authority", str(away), *home, "--json", "--yes"),
    )
    assert said.exit_code == 0, said.output
    assert json.loads(said.stdout)["hosts"] == ["127.0.0.1", "node-1.clinic.example"]
    assert run("install", "node-1", str(made), *home).exit_code == 0
    report = read_report(config)
    assert report.state(now_ms()) == "valid"
    assert 89 <= report.days_left(now_ms()) <= 90
    assert config.tls_key_path.read_bytes() == key
    for path in (asked, made, config.tls_certificate_path):
        assert b"PRIVATE" not in path.read_bytes()
    assert secrets == (away / "ca.key.pem").read_bytes()
    assert stat.S_IMODE(config.tls_certificate_path.stat().st_mode) == 0o600
    assert "FILE_EXISTS" in run("request", "node-1", "--out", str(asked), *home).stderr


def test_a_request_names_what_the_certificate_named_unless_told_otherwise(config: NodeConfig) -> None:
    request = x509.load_pem_x509_csr(make_request(config, "hospital", ["127.0.0.1"]))
    assert certified_hosts(request) == ("127.0.0.1",)


def test_a_certificate_that_does_not_name_where_a_node_is_reached_leaves_the_old_one(
    folder: Path, config: NodeConfig, authority: Authority
) -> None:
    old = config.tls_certificate_path.read_bytes()
    path = folder.parent / "made.crt.pem"
    for hosts, is_fit in ((["10.0.0.7"], False), (["10.0.0.7", "127.0.0.1"], True)):
        path.write_bytes(pem_of(sign_request(authority, make_request(config, "hospital", hosts), 90)))
        said = run("install", config.name, str(path), "--dir", str(folder))
        assert ("CERTIFICATE_UNFIT" in said.stderr) == (not is_fit)
        assert (config.tls_certificate_path.read_bytes() == old) == (not is_fit)
    assert read_report(config).state(now_ms()) == "valid"


def test_a_certificate_is_not_renewed_without_the_address_at_which_its_node_is_reached(
    folder: Path, config: NodeConfig
) -> None:
    old = config.tls_certificate_path.read_bytes()
    said = run("renew", "node-1", "--host", "10.0.0.7", "--dir", str(folder))
    assert "CERTIFICATE_UNFIT" in said.stderr
    assert "--host OLD --host NEW" in said.stderr
    assert config.tls_certificate_path.read_bytes() == old
    assert run("renew", "node-1", "--host", "10.0.0.7", "--host", "127.0.0.1", "--dir", str(folder)).exit_code == 0
    assert certified_hosts(x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())) == (
        "10.0.0.7",
        "127.0.0.1",
    )


def test_a_certificate_is_not_renewed_by_an_authority_that_the_network_does_not_know(
    folder: Path, config: NodeConfig, directory: DirectoryContent
) -> None:
    """Unless the network knows it by now, which a node that was cut off has not seen."""
    stranger, old = create_authority("hospital"), config.tls_certificate_path.read_bytes()
    place, known = folder.parent / "new-ca", folder.parent / "directory.json"
    write_secret(place / "ca.key.pem", encode_private_key(stranger.key))
    (place / "ca.crt.pem").write_text(stranger.certificate_pem)
    renewal = ("renew", "node-1", "--authority", str(place), "--dir", str(folder))
    for options in ((), ("--new-key",)):
        said = run(*renewal, *options)
        assert "PEER_CERTIFICATE_FOREIGN" in said.stderr
        assert config.tls_certificate_path.read_bytes() == old
        assert read_report(config).state(now_ms()) == "valid"
    owner = replace(directory.organisations["hospital"], ca_certificate=stranger.certificate_pem)
    newer = replace(directory, height=9, organisations={**directory.organisations, "hospital": owner})
    known.write_bytes(encode_directory(Cluster(folder).genesis.chain_id, newer))
    assert run(*renewal, "--directory", str(known)).exit_code == 0
    assert config.tls_certificate_path.read_bytes() != old


@pytest.mark.parametrize("is_founding", [False, True])
def test_a_certificate_that_cannot_be_read_is_renewed_for_where_others_reach_the_node(
    folder: Path, tmp_path: Path, is_founding: bool
) -> None:
    """Not for where it listens, which may be everywhere."""
    home, words = folder, ("--bind", "0.0.0.0", "--advertise", "ward-1.hospital.example")
    if is_founding:
        home = tmp_path / "founder"
        create_organisation(home, "hospital")
        words = (*words, "--founding")
    made = CliRunner().invoke(init, ["ward-1", "--organisation", "hospital", *words, "--dir", str(home)])
    assert made.exit_code == 0, made.output
    config = load_config(home / "nodes" / "ward-1")
    if not is_founding:
        entered = content_of_genesis(Cluster(folder).genesis)
        fields = read_node_entry(config.data_dir / NODE_ENTRY_FILE)
        del fields["producer_possession"]
        newer = replace(entered, height=9, nodes={**entered.nodes, "ward-1": DirectoryNode(**fields)})
        (tmp_path / "directory.json").write_bytes(encode_directory(Cluster(folder).genesis.chain_id, newer))
    config.tls_certificate_path.write_bytes(b"rubbish")
    known = () if is_founding else ("--directory", str(tmp_path / "directory.json"))
    said = run("renew", "ward-1", "--dir", str(home), *known)
    assert said.exit_code == 0, said.output
    renewed = x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())
    assert certified_hosts(renewed) == ("ward-1.hospital.example",)


def request_of(
    key: Any, organisation: str = "hospital", name: str = "node-1", *, names: list[x509.GeneralName] | None = None
) -> bytes:
    """`names`: else the node's own; without a name of the node: none in its subject."""
    subject = [x509.NameAttribute(NameOID.ORGANIZATION_NAME, organisation)]
    if name:
        subject.append(x509.NameAttribute(NameOID.COMMON_NAME, name))
    builder = x509.CertificateSigningRequestBuilder().subject_name(x509.Name(subject))
    found = [x509.DNSName(name)] if names is None else names
    if found:
        builder = builder.add_extension(x509.SubjectAlternativeName(found), critical=False)
    algorithm = None if isinstance(key, ed25519.Ed25519PrivateKey) else hashes.SHA256()
    return builder.sign(key, algorithm).public_bytes(serialization.Encoding.PEM)


def test_an_authority_signs_requests_of_its_organisation_alone_and_only_what_is_asked(authority: Authority) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    made = sign_request(authority, request_of(key), 10)
    constraints = made.extensions.get_extension_for_class(x509.BasicConstraints).value
    assert not constraints.ca
    assert made.public_key() == key.public_key()
    whole = request_of(key)
    swapped = bytearray(x509.load_pem_x509_csr(whole).public_bytes(serialization.Encoding.DER))
    swapped[-1] ^= 1
    forged = ssl.DER_cert_to_PEM_cert(bytes(swapped)).replace("CERTIFICATE", "CERTIFICATE REQUEST").encode()
    for wrong in (
        request_of(key, "university"),
        request_of(key, names=[]),
        request_of(key, name="", names=[x509.DNSName("node-1")]),
        request_of(ed25519.Ed25519PrivateKey.generate()),
        forged,
        b"",
        b"-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n-----END CERTIFICATE REQUEST-----\n",
        authority.certificate_pem.encode(),
    ):
        with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE"):
            sign_request(authority, wrong, 10)


def test_only_names_and_addresses_of_hosts_are_certified_of_what_a_request_names(authority: Authority) -> None:
    person = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Estação 1")])
    names = [
        x509.DirectoryName(person),
        x509.RFC822Name("ward@hospital.example"),
        x509.DNSName("ward-1.hospital.example"),
    ]
    made = sign_request(authority, request_of(ec.generate_private_key(ec.SECP256R1()), names=names), 10)
    assert certified_hosts(made) == ("ward-1.hospital.example",)
    named = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert list(named) == [x509.DNSName("node-1"), x509.DNSName("ward-1.hospital.example")]


@pytest.mark.parametrize(
    ("name", "hosts", "why"),
    [
        ("ward-7;touch$IFS/tmp/x;echo", ["10.0.0.7"], "is no name of a node"),
        ("Ward-7", ["10.0.0.7"], "is no name of a node"),
        ("node-2", ["10.0.0.2"], "is a node of 'university'"),
        ("ward-7", ["10.0.0.7", "node-2"], "names 'node-2' besides"),
        ("node-1", ["10.0.0.1", "NODE-2"], "names 'NODE-2' besides"),
        ("ward-7", ["*.hospital.example"], "names '*.hospital.example' besides"),
        ("node-1", ["10.0.0.1", "node-2."], "names 'node-2.' besides"),
        ("ward-7", ["10.0.0.7\nnode-1 of hospital, too"], r"names '10.0.0.7\nnode-1 of hospital, too' besides"),
        ("ward-7", ["10.0.0.7\x1b[2K"], r"names '10.0.0.7\x1b[2K' besides"),
        ("ward-8", ["10.0.0.7"], "is of 'ward-8', not of 'ward-7'"),
    ],
)
def test_nothing_is_signed_by_which_one_node_could_answer_as_another(
    folder: Path, tmp_path: Path, name: str, hosts: list[str], why: str
) -> None:
    asked, out = tmp_path / "asked.csr", tmp_path / "made.pem"
    names = [x509.DNSName(name), *host_names(hosts)]
    asked.write_bytes(request_of(ec.generate_private_key(ec.SECP256R1()), name=name, names=names))
    expected = ("--node", "ward-7") if name == "ward-8" else ()
    sign = ("sign", str(asked), "--organisation", "hospital", "--out", str(out), "--dir", str(folder), "--yes")
    said = run(*sign, *expected)
    assert "FILE_UNUSABLE" in said.stderr
    assert why in said.stderr.replace("\n", " ")
    assert not out.exists()


def test_what_is_asked_for_is_shown_before_it_is_certified(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, out = tmp_path / "asked.csr", tmp_path / "made here.pem"
    names = [x509.DNSName("ward-7"), *host_names(["10.0.0.7", "ward-7.hospital.example"])]
    asked.write_bytes(request_of(ec.generate_private_key(ec.SECP256R1()), name="ward-7", names=names))
    sign = ["sign", str(asked), "--organisation", "hospital", "--out", str(out), "--dir", str(folder)]
    assert "give --yes" in run(*sign).stderr
    monkeypatch.setattr(certificate_commands, "can_ask", lambda: True)
    for answer, is_signed in (("n", False), ("y", True)):
        said = CliRunner().invoke(certificate, sign, input=f"{answer}\n")
        assert "ward-7 of hospital" in said.stderr
        assert "10.0.0.7, ward-7.hospital.example" in said.stderr
        assert out.exists() == is_signed
        assert (said.exit_code == 0) == is_signed
    assert f"certificate install ward-7 {shlex.quote(str(out))}" in said.stdout


def test_an_authority_whose_certificate_names_no_key_identifier_signs_too(authority: Authority) -> None:
    bare = (
        x509.CertificateBuilder()
        .subject_name(authority.certificate.subject)
        .issuer_name(authority.certificate.subject)
        .public_key(authority.key.public_key())
        .serial_number(7)
        .not_valid_before(dt.datetime.now(dt.UTC) - dt.timedelta(days=1))
        .not_valid_after(dt.datetime.now(dt.UTC) + dt.timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(authority.key, hashes.SHA256())
    )
    made = sign_request(replace(authority, certificate=bare), request_of(ec.generate_private_key(ec.SECP256R1())), 10)
    made.verify_directly_issued_by(bare)


def test_a_node_takes_no_certificate_that_is_not_its_own(
    config: NodeConfig, authority: Authority, directory: DirectoryContent
) -> None:
    own, day = read_private_key(config.tls_key_path).public_key(), dt.timedelta(days=1)
    good = certify(authority, "node-1", ["127.0.0.1"], own, day)
    assert check_certificate(config, pem_of(good), directory, now_ms()) == good
    stranger = create_authority("hospital")
    other = ec.generate_private_key(ec.SECP256R1()).public_key()
    wrong = {
        "FILE_UNUSABLE": certify(authority, "node-1", ["127.0.0.1"], other, day),
        "PEER_CERTIFICATE_FOREIGN": certify(stranger, "node-1", ["127.0.0.1"], own, day),
        "PEER_CERTIFICATE_EXPIRED": certify(authority, "node-1", ["127.0.0.1"], own, -day),
        "PEER_REFUSED": certify(authority, "node-9", ["127.0.0.1"], own, day),
    }
    for code, made in wrong.items():
        with pytest.raises(BlockRobotError, match=f"^{code}"):
            check_certificate(config, pem_of(made), directory, now_ms())
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE"):
        check_certificate(config, b"none", directory, now_ms())


def test_an_intermediate_authority_is_enough_for_peers_and_clients(
    config: NodeConfig, authority: Authority, directory: DirectoryContent
) -> None:
    """A hospital's root stays offline: the network knows the certificate of the one that signs for nodes."""
    root = create_authority("hospital")
    key = authority.key.public_key()
    intermediate = (
        x509.CertificateBuilder()
        .subject_name(authority.certificate.subject)
        .issuer_name(root.certificate.subject)
        .public_key(key)
        .serial_number(7)
        .not_valid_before(dt.datetime.now(dt.UTC) - dt.timedelta(days=1))
        .not_valid_after(dt.datetime.now(dt.UTC) + dt.timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
        .sign(root.key, hashes.SHA256())
    )
    owner = replace(directory.organisations["hospital"], ca_certificate=pem_of(intermediate).decode())
    known = replace(directory, organisations=directory.organisations | {"hospital": owner})
    own = read_private_key(config.tls_key_path).public_key()
    made = certify(
        Authority("hospital", intermediate, authority.key), "node-1", ["127.0.0.1"], own, dt.timedelta(days=1)
    )
    assert check_certificate(config, pem_of(made), known, now_ms()) == made
    config.tls_certificate_path.write_bytes(pem_of(made))
    credentials = Credentials(config.tls_certificate_path, config.tls_key_path, known)
    for server, client in (
        (credentials.accepting, credentials.dialling("hospital")),
        (credentials.serving, _client(pem_of(intermediate))),
    ):
        shake_hands(server, client)


def _client(trusted: bytes) -> ssl.SSLContext:
    context = connections.tls_context(connections.NodeAddress("node-1", "https://127.0.0.1:1", trusted.decode()))
    assert isinstance(context, ssl.SSLContext)
    return context


def shake_hands(server: ssl.SSLContext, client: ssl.SSLContext) -> None:
    """In memory. Raises ssl.SSLError."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    sides = [
        client.wrap_bio(to_client, to_server, server_hostname="127.0.0.1"),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    for _ in range(6):
        for side in list(sides):
            try:
                side.do_handshake()
                sides.remove(side)
            except ssl.SSLWantReadError:
                continue
    assert sides == []
