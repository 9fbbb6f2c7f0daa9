"""A founder whose certificate authority is elsewhere: a request goes there, and the node is entered once it is answered."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from consensus.chain.genesis import genesis_from_json
from network.cli.main import main
from network.provisioning.certificate_authority import certified_hosts
from network.provisioning.founding import check_genesis, find_own_entries

NODE = "ward-1"


class HospitalAuthority:
    """An authority of a hospital's own, with its own name and programs."""

    def __init__(self) -> None:
        self.key = ec.generate_private_key(ec.SECP256R1())
        self.name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Santa Maria Servers CA")])
        made = self._builder(self.name, self.key.public_key(), is_authority=True).sign(self.key, hashes.SHA256())
        self.pem = made.public_bytes(Encoding.PEM)

    def _builder(self, subject: x509.Name, key: Any, *, is_authority: bool) -> x509.CertificateBuilder:
        now = dt.datetime.now(dt.UTC)
        return (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(self.name)
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - dt.timedelta(hours=1))
            .not_valid_after(now + dt.timedelta(days=9))
            .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
        )

    def sign(self, request: Path, out: Path, *, names: bool = True, purposes: tuple[Any, ...] | None = None) -> Path:
        asked = x509.load_pem_x509_csr(request.read_bytes())
        builder = self._builder(asked.subject, asked.public_key(), is_authority=False)
        if names:
            extension = asked.extensions.get_extension_for_class(x509.SubjectAlternativeName)
            builder = builder.add_extension(extension.value, critical=False)
        if purposes is not None:
            builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        out.write_bytes(builder.sign(self.key, hashes.SHA256()).public_bytes(Encoding.PEM))
        return out


class Founder:
    """A party's folder, and the commands typed there."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.network = home / "network"
        self.data_dir = self.network / "nodes" / NODE
        self.entry = self.data_dir / "node-entry.json"
        self.request = self.data_dir / "node.csr"
        self.authority = HospitalAuthority()
        (home / "ca.pem").write_bytes(self.authority.pem)

    def type(self, *words: str) -> Result:
        return CliRunner().invoke(main, [*words, "--dir", str(self.network)])

    def ok(self, *words: str) -> str:
        return self._done(self.type(*words))

    def make_genesis(self, out: Path) -> None:
        entries = map(str, find_own_entries(self.network))
        self._done(CliRunner().invoke(main, ["genesis", "make", *entries, "--out", str(out)]))

    @staticmethod
    def _done(said: Result) -> str:
        assert said.exit_code == 0, said.output
        return said.output

    def refused(self, *words: str) -> str:
        said = self.type(*words, "--json")
        assert said.exit_code != 0, said.output
        return str(json.loads(said.stdout)["error"]["code"])

    def begin(self) -> str:
        self.ok("org", "new", "hospital", "--certificate", str(self.home / "ca.pem"))
        where = ("--bind", "0.0.0.0", "--advertise", "ward-1.hospital.example")
        return self.ok("node", "init", NODE, "--founding", "--organisation", "hospital", *where)

    def certify(self) -> Path:
        return self.authority.sign(self.request, self.home / "node.pem")


@pytest.fixture
def founder(tmp_path: Path) -> Founder:
    return Founder(tmp_path)


def test_the_node_is_entered_once_its_certificate_comes_from_elsewhere(founder: Founder) -> None:
    said = founder.begin()
    assert f"certificate install {NODE} CERTIFICATE" in said
    assert not founder.entry.exists()
    assert not list(founder.network.rglob("ca.key.pem"))
    founder.ok("certificate", "install", NODE, str(founder.certify()))
    assert {path.name for path in founder.data_dir.iterdir() if path.is_file()} == {"node-entry.json", "node.toml"}

    out = founder.home / "genesis.json"
    founder.make_genesis(out)
    founder.ok("genesis", "check", str(out), "--adopt")
    genesis = genesis_from_json(out.read_text())
    check_genesis(genesis)
    assert genesis.organisations[0].ca_certificate.encode() == founder.authority.pem


def test_the_request_asks_for_the_names_by_which_the_node_is_reached(founder: Founder) -> None:
    founder.begin()
    asked = x509.load_pem_x509_csr(founder.request.read_bytes())
    assert certified_hosts(asked) == ("ward-1.hospital.example",)
    again = founder.home / "again.csr"
    founder.ok("certificate", "request", NODE, "--out", str(again))
    assert certified_hosts(x509.load_pem_x509_csr(again.read_bytes())) == ("ward-1.hospital.example",)


def test_nothing_goes_on_before_the_certificate_is_here(founder: Founder) -> None:
    founder.begin()
    draft = founder.data_dir / "node-entry.draft.json"
    organisation = founder.network / "organisations" / "hospital" / "organisation-entry.json"
    out = founder.home / "genesis.json"
    made = CliRunner().invoke(main, ["genesis", "make", str(draft), str(organisation), "--out", str(out), "--json"])
    assert json.loads(made.stdout)["error"]["code"] == "FOUNDING_ENTRY_INVALID"
    (founder.home / "other").mkdir()
    other = Founder(founder.home / "other")
    other.begin()
    other.ok("certificate", "install", NODE, str(other.certify()))
    other.make_genesis(out)
    assert founder.refused("genesis", "check", str(out), "--adopt") == "NODE_NOT_CERTIFIED"
    assert founder.refused("node", "run", NODE) == "NODE_NOT_CERTIFIED"
    assert founder.refused("certificate", "renew", NODE) == "AUTHORITY_NOT_HERE"


def test_a_certificate_that_would_not_serve_is_refused_and_the_node_is_not_entered(founder: Founder) -> None:
    founder.begin()
    sign, out = founder.authority.sign, founder.home / "node.pem"
    elsewhere = HospitalAuthority().sign(founder.request, founder.home / "foreign.pem")
    assert founder.refused("certificate", "install", NODE, str(elsewhere)) == "PEER_CERTIFICATE_FOREIGN"
    nameless = sign(founder.request, out, names=False)
    assert founder.refused("certificate", "install", NODE, str(nameless)) == "CERTIFICATE_UNFIT"
    one_sided = sign(founder.request, out, purposes=(ExtendedKeyUsageOID.SERVER_AUTH,))
    assert founder.refused("certificate", "install", NODE, str(one_sided)) == "CERTIFICATE_UNFIT"
    assert founder.refused("certificate", "install", NODE, str(founder.request)) == "FILE_UNUSABLE"
    assert founder.refused("certificate", "install", NODE, str(founder.home / "ca.pem")) == "FILE_UNUSABLE"
    assert not founder.entry.exists()
    both = sign(founder.request, out, purposes=(ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH))
    founder.ok("certificate", "install", NODE, str(both))


def test_a_second_certificate_before_the_founding_leaves_the_entry_as_it_was_handed_over(founder: Founder) -> None:
    founder.begin()
    first = founder.certify()
    founder.ok("certificate", "install", NODE, str(first))
    handed = founder.entry.read_bytes()
    again = founder.home / "again.csr"
    founder.ok("certificate", "request", NODE, "--out", str(again))
    second = founder.authority.sign(again, founder.home / "second.pem")
    founder.ok("certificate", "install", NODE, str(second))
    assert founder.entry.read_bytes() == handed
    assert (founder.data_dir / "keys" / "tls.crt.pem").read_bytes() == second.read_bytes()


def test_a_node_before_its_organisation_is_told_what_is_missing(founder: Founder) -> None:
    init = ("node", "init", NODE, "--founding", "--organisation", "hospital")
    assert founder.refused(*init) == "ORGANISATION_KEY_NOT_FOUND"


def test_only_an_authoritys_certificate_makes_an_organisation_and_no_key_comes_along(founder: Founder) -> None:
    new = ("org", "new", "hospital", "--certificate")
    founder.begin()
    leaf = founder.certify()
    key = founder.authority.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (founder.home / "both.pem").write_bytes(founder.authority.pem + key)
    other = Founder(founder.network)
    assert other.refused(*new, str(leaf)) == "AUTHORITY_INVALID"
    assert other.refused(*new, str(founder.home / "both.pem")) == "FILE_HOLDS_PRIVATE_KEY"
    assert other.refused(*new, str(founder.request)) == "FILE_UNUSABLE"
    assert not (other.network / "organisations").exists()


def test_an_authority_that_this_program_made_elsewhere_may_sign_the_request(founder: Founder, tmp_path: Path) -> None:
    """As where an organisation keeps its authority on a machine of its own, made by the same program."""
    safe = tmp_path / "safe"
    assert CliRunner().invoke(main, ["org", "new", "hospital", "--dir", str(safe)]).exit_code == 0
    (founder.home / "ca.pem").write_bytes((safe / "organisations" / "hospital" / "ca.crt.pem").read_bytes())
    founder.begin()
    out = founder.home / "node.pem"
    sign = ["certificate", "sign", str(founder.request), "--organisation", "hospital", "--out", str(out), "--yes"]
    said = CliRunner().invoke(main, [*sign, "--dir", str(safe)])
    assert said.exit_code == 0, said.output
    founder.ok("certificate", "install", NODE, str(out))
    assert founder.entry.exists()
