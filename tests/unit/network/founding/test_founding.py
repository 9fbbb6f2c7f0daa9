"""Several parties found a network: each hands over public files, and all make the same genesis file of them."""

from __future__ import annotations

import asyncio
import errno
import json
import random
import shutil
import stat
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import Result
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from clients.sdk.trust_pin import PIN_FILE
from consensus.chain.genesis import Genesis, genesis_from_json, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from contracts.execution.genesis import complete_genesis
from network.cli.governance.genesis_commands import genesis as genesis_group
from network.cli.governance.governance_signer import read_private_key
from network.cli.governance.org_commands import org
from network.cli.node.node_setup_commands import init
from network.provisioning import founding, new_organisation
from network.provisioning.authority_check import fingerprints
from network.provisioning.founding import check_genesis, find_differences, fingerprint, make_genesis
from network.provisioning.founding_entries import node_entry_to_json, organisation_entry_to_json, read_offers
from node.config import load_config, load_genesis
from node.directory.directory_file import encode_directory
from node.directory.node_directory import DirectoryOrganisation, content_of_genesis
from node.storage.directory_lock import DirectoryLock
from node.storage.lmdb_store import LmdbStore
from tests.unit.network.founding.conftest import PARTIES, Change, change, made_of, run


def test_the_same_entries_make_the_same_file_in_any_order_and_however_often(handed: dict[str, Path]) -> None:
    paths = list(handed.values())
    first = genesis_to_json(made_of(*paths))
    for seed in range(5):
        random.Random(seed).shuffle(paths)
        assert genesis_to_json(made_of(*paths, *paths[:2])) == first
    genesis = genesis_from_json(first)
    assert [entry.name for entry in genesis.organisations] == ["clinic", "hospital", "university"]
    assert [entry.name for entry in genesis.nodes] == ["lab-1", "ward-1", "ward-2", "ward-10"]
    assert [bool(entry.producer_key) for entry in genesis.nodes] == [True, True, True, False]
    assert {entry.api_url for entry in genesis.nodes} >= {"https://10.0.1.1:7273", "https://[fd00::1]:7283"}


def test_each_party_finds_its_own_entries_in_it_and_its_nodes_begin_with_it(world: Path, tmp_path: Path) -> None:
    out = tmp_path / "genesis.json"
    said = run(genesis_group, "make", *map(str, sorted((world / "handed").iterdir())), "--out", str(out), "--json")
    assert said.exit_code == 0, said.output
    answer = json.loads(said.stdout)
    for owner, nodes in PARTIES.items():
        seen = run(genesis_group, "check", str(out), "--adopt", "--dir", str(world / owner), "--json")
        assert seen.exit_code == 0, seen.output
        checked = json.loads(seen.stdout)
        assert checked["fingerprint"] == answer["fingerprint"]
        (own,) = (each for each in checked["organisations"] if each["name"] == owner)
        authority = world / owner / "organisations" / owner / "ca.crt.pem"
        assert own["authorities"] == fingerprints(authority.read_text())
        assert set(checked["adopted"]) == set(nodes)
        for node in nodes:
            config = load_config(world / owner / "nodes" / node)
            assert load_genesis(config).chain_id.hex() == answer["chain_id"]
    shown = run(genesis_group, "check", str(out), "--dir", str(tmp_path / "nobody"))
    assert "nothing to compare" in shown.output
    assert all(each["authorities"][0][:8] in shown.output for each in answer["organisations"])
    said = run(genesis_group, "make", str(out), "--out", str(tmp_path / "other.json"))
    assert "FILE_UNUSABLE" in said.stderr, "a genesis file is no entry"


def test_nothing_that_is_handed_over_holds_a_secret(world: Path, handed: dict[str, Path]) -> None:
    secrets = [path.read_bytes() for path in world.rglob("*.key")]
    for path in world.rglob("*key.pem"):
        key = load_pem_private_key(path.read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        secrets.append(key.private_numbers().private_value.to_bytes(32, "big"))
    genesis = made_of(*handed.values())
    texts = [*(path.read_bytes() for path in handed.values()), genesis_to_json(genesis).encode()]
    der = [x509.load_pem_x509_certificate(owner.ca_certificate.encode()) for owner in genesis.organisations]
    public = b"".join([*texts, *(certificate.public_bytes(Encoding.DER) for certificate in der)])
    assert len(secrets) == 2 * 3 + 2 * 4 + 3 + 4
    assert not any(secret in public or secret.hex().encode() in public for secret in secrets)


def test_without_an_entry_of_its_organisation_a_node_founds_nothing(handed: dict[str, Path]) -> None:
    del handed["university"]
    with pytest.raises(
        BlockRobotError, match=r"^FOUNDING_ENTRY_INVALID: .*lab-1.json is of the organisation 'university'"
    ):
        made_of(*handed.values())
    with pytest.raises(BlockRobotError, match=r"^FOUNDING_ENTRY_INVALID: .* 0 producers"):
        made_of(handed["hospital"])


def put(field: str, value: Any) -> Change:
    return lambda document: document.update({field: value})


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("hospital", put("name", "university")),
        ("hospital", put("admins", [])),
        ("hospital", put("registrars", [])),
        ("hospital", put("proofs", [])),
        ("hospital", put("proofs", None)),
        ("hospital", lambda document: document["proofs"].reverse()),
        ("ward-1", put("host", "10.0.9.9")),
        ("ward-1", put("p2p_port", 1)),
        ("ward-1", put("p2p_port", "7272")),
        ("ward-1", put("made_at_ms", 1)),
        ("ward-1", put("made_at_ms", 1 << 70)),
        ("ward-1", put("organisation", "university")),
        ("ward-1", put("custodian_key", "")),
        ("ward-1", put("signature", "")),
        ("ward-1", put("admin", "00")),
        ("ward-1", put("custodian_proof", "")),
        ("ward-1", put("custodian_proof", None)),
        ("ward-1", lambda document: document.pop("custodian_proof")),
    ],
)
def test_an_entry_that_was_changed_on_the_way_is_refused_by_its_name(
    handed: dict[str, Path], name: str, how: Change
) -> None:
    change(handed[name], how)
    with pytest.raises(BlockRobotError, match=rf"^FOUNDING_ENTRY_INVALID: \S*{name}.json "):
        made_of(*handed.values())


def test_a_name_that_is_no_text_is_refused(handed: dict[str, Path]) -> None:
    text = handed["hospital"].read_text()
    handed["hospital"].write_text(text.replace('"name": "hospital"', '"name": "\\ud800"'))
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE: \S*hospital.json "):
        made_of(*handed.values())


def sign_anew(path: Path, owner: Path, **fields: Any) -> Path:
    """As a hostile party would that has its own admin's and its own custodian's key."""
    (offer,) = read_offers([path])[1]
    entry = msgspec.structs.replace(offer.entry, **fields)
    admin = read_private_key(owner / "organisations" / owner.name / "admin.key")
    custodian = read_private_key(owner / "nodes" / offer.entry.name / "keys" / "custodian.key")
    path.write_text(node_entry_to_json(entry, offer.made_at_ms, admin, custodian))
    return path


@pytest.mark.parametrize("what", ["another's node", "address", "url", "custodian key", "producer key", "name"])
def test_a_hostile_party_enters_nothing_of_somebody_elses(world: Path, handed: dict[str, Path], what: str) -> None:
    (ward,) = read_offers([handed["ward-1"]])[1]
    fields: dict[str, dict[str, Any]] = {
        "another's node": {"organisation": "hospital"},
        "address": {"host": ward.entry.host, "p2p_port": ward.entry.p2p_port},
        "url": {"api_url": ward.entry.api_url},
        "custodian key": {"custodian_key": ward.entry.custodian_key},
        "producer key": {
            "producer_key": ward.entry.producer_key,
            "producer_possession": ward.entry.producer_possession,
        },
        "name": {"name": "ward-1"},
    }
    sign_anew(handed["lab-1"], world / "university", **fields[what])
    with pytest.raises(BlockRobotError, match=r"^(FOUNDING_ENTRY_INVALID|GENESIS_INVALID): .*(lab-1|ward-1)"):
        made_of(*handed.values())


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ("a node's certificate", "is not that of an authority"),
        ("another's authority beside its own", "is that of hospital, not of clinic"),
        ("no admin", "ADMINS_MISSING"),
        ("too many registrars", "KEYS_TOO_MANY"),
    ],
)
def test_what_the_chain_lets_in_of_no_organisation_founds_no_network(
    world: Path, handed: dict[str, Path], what: str, why: str
) -> None:
    """Its voice would count for the majority, and nobody could speak with it; or it would vouch for another's nodes."""
    true, home = made_of(*handed.values()), world / "clinic"
    own = {name: read_private_key(home / "organisations" / "clinic" / f"{name}.key") for name in ("admin", "registrar")}
    more = [PrivateKey(bytes([number]) * 32) for number in range(1, 18)]
    (clinic, hospital) = (
        next(each for each in true.organisations if each.name == name) for name in ("clinic", "hospital")
    )
    fields: dict[str, dict[str, Any]] = {
        "a node's certificate": {"ca_certificate": (home / "nodes" / "ward-2" / "keys" / "tls.crt.pem").read_text()},
        "another's authority beside its own": {"ca_certificate": clinic.ca_certificate + hospital.ca_certificate},
        "no admin": {"admins": ()},
        "too many registrars": {"registrars": tuple(key.public_key for key in more)},
    }
    false = msgspec.structs.replace(clinic, **fields[what])
    keys = [own["admin"]] * len(false.admins) + ([own["registrar"]] if len(false.registrars) == 1 else more)
    handed["clinic"].write_text(organisation_entry_to_json(false, keys))
    nodeless = [path for name, path in handed.items() if name != "ward-2"]
    with pytest.raises(BlockRobotError, match=rf"^FOUNDING_ENTRY_INVALID: \S*clinic.json cannot be used: .*{why}"):
        made_of(*nodeless)
    others = tuple(each for each in true.organisations if each.name != "clinic")
    genesis = msgspec.structs.replace(true, organisations=(false, *others))
    with pytest.raises(BlockRobotError, match=rf"^FOUNDING_ENTRY_INVALID: organisation clinic cannot be used: .*{why}"):
        check_genesis(complete_genesis(genesis))


def test_a_custodian_key_that_was_stolen_without_its_secret_half_is_entered_by_nobody(
    world: Path, handed: dict[str, Path]
) -> None:
    """Also where its owner is not among the entries, so that no key is named twice."""
    (ward,) = read_offers([handed.pop("ward-1")])[1]
    sign_anew(handed["lab-1"], world / "university", custodian_key=ward.entry.custodian_key)
    with pytest.raises(
        BlockRobotError, match=r"^FOUNDING_ENTRY_INVALID: .*lab-1.json does not prove .* the custodian key"
    ):
        made_of(*handed.values())


@pytest.mark.parametrize(
    "fields",
    [
        {"api_url": "http://10.0.2.1:7273"},
        {"api_url": "https://10.0.2.1\n:7273"},
        {"api_url": "https://10.0.2.1:7273/node"},
        {"api_url": "https://10.0.2.1:7273/"},
        {"api_url": "https://10.0.2.1:7273?"},
        {"api_url": "https://10.0.2.1:7273#"},
        {"api_url": "https://who@10.0.2.1:7273"},
        {"api_url": "https://10.0.2.1:07273"},
        {"api_url": "https://lab.example:443"},
        {"api_url": "https://LAB.example"},
        {"api_url": "https://lab.example."},
        {"api_url": "https://lab..example"},
        {"api_url": "https://[fd00:0:0::2]:7273"},
        {"api_url": "https://[::ffff:10.0.2.1]:7273"},
        {"host": "10.0.2.1\x1b[2J"},
        {"host": "Lab.example"},
        {"host": "lab.example."},
        {"host": "lab..example"},
        {"host": f"{'l' * 64}.example"},
        {"host": "-lab.example"},
        {"host": "xn--zz.example"},
        {"host": "10.2.1"},
        {"host": "0x0a.0x1"},
        {"host": "fd00:0:0::2"},
        {"host": "FD00::2"},
        {"host": "::ffff:10.0.2.1"},
        {"host": "fe80::1%eth0"},
        {"p2p_port": 65_536},
        {"p2p_port": 7273},
    ],
    ids=str,
)
def test_an_address_has_one_form_so_that_no_place_is_two(
    world: Path, handed: dict[str, Path], fields: dict[str, Any]
) -> None:
    sign_anew(handed["lab-1"], world / "university", **fields)
    with pytest.raises(BlockRobotError, match=r"^FOUNDING_ENTRY_INVALID: \S*lab-1.json "):
        made_of(*handed.values())


def test_two_parties_of_one_name_are_both_named(world: Path, handed: dict[str, Path], tmp_path: Path) -> None:
    assert run(org, "new", "hospital", "--dir", str(tmp_path / "impostor")).exit_code == 0
    second = tmp_path / "impostor" / "organisations" / "hospital" / "organisation-entry.json"
    with pytest.raises(BlockRobotError, match=r"^FOUNDING_ENTRY_INVALID: .* has the name 'hospital' that .* has too"):
        made_of(*handed.values(), second)


def test_a_genesis_file_that_says_otherwise_of_a_partys_own_is_refused_with_the_difference(
    world: Path, handed: dict[str, Path], tmp_path: Path
) -> None:
    true = made_of(*handed.values())
    (ward,) = [entry for entry in true.nodes if entry.name == "ward-1"]
    keyless = {"custodian_key": b"", "producer_key": b"", "producer_possession": b""}
    place = {"host": "10.0.9.8", "api_url": "https://10.0.9.8:7273"}
    spy = msgspec.structs.replace(ward, name="ward-9", **place, **keyless)
    others = tuple(entry for entry in true.nodes if entry.name != "ward-1")
    false = {
        "node ward-1: host is another one": (*others, msgspec.structs.replace(ward, host="10.0.9.9")),
        "node ward-1: it is missing": others,
        "node ward-9: it is entered as one of hospital": (*true.nodes, spy),
    }
    for difference, nodes in false.items():
        path = tmp_path / "false.json"
        path.write_text(genesis_to_json(msgspec.structs.replace(true, nodes=nodes)))
        said = run(genesis_group, "check", str(path), "--dir", str(world / "hospital"), "--json")
        assert said.exit_code == 1
        assert "GENESIS_INVALID" in said.stdout + said.stderr, "its state root is that of the true one"
        path.write_text(genesis_to_json(complete_genesis(msgspec.structs.replace(true, nodes=nodes))))
        said = run(genesis_group, "check", str(path), "--dir", str(world / "hospital"))
        assert said.exit_code == 1
        assert "GENESIS_DIFFERS" in said.stderr
        assert difference in " ".join(said.stderr.split())


def test_an_organisation_is_not_swapped_where_only_its_node_is(
    world: Path, handed: dict[str, Path], tmp_path: Path
) -> None:
    """A node's host may hold no entry of its organisation; its own entry was signed by an admin of it."""
    true = made_of(*handed.values())
    assert run(org, "new", "hospital", "--dir", str(tmp_path / "impostor")).exit_code == 0
    entry = tmp_path / "impostor" / "organisations" / "hospital" / "organisation-entry.json"
    (impostor,) = read_offers([entry])[0]
    others = tuple(owner for owner in true.organisations if owner.name != "hospital")
    founders = sorted((*others, impostor.organisation), key=lambda owner: owner.name)
    swapped = msgspec.structs.replace(true, organisations=tuple(founders))
    path, data_dir = tmp_path / "swapped.json", world / "hospital" / "nodes" / "ward-1"
    path.write_text(genesis_to_json(complete_genesis(swapped)))
    here = ("--data-dir", str(data_dir), "--dir", str(tmp_path / "desk"))
    said = run(genesis_group, "check", str(path), "--adopt", *here)
    assert "GENESIS_DIFFERS" in said.stderr
    assert "its admins are others" in " ".join(said.stderr.split())
    path.write_text(genesis_to_json(true))
    assert run(genesis_group, "check", str(path), "--adopt", *here).exit_code == 0, "into a folder that was not there"
    assert (tmp_path / "desk" / "genesis.json").read_bytes() == path.read_bytes()


def test_an_organisation_is_made_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However far the making came, the next try begins anew."""
    written = new_organisation.write_secret
    for reached in range(3):
        left = iter([True] * reached)

        def write(path: Path, data: bytes, left: Iterator[bool] = left) -> None:
            if not next(left, False):
                raise OSError(errno.ENOSPC, "No space left on device")
            written(path, data)

        monkeypatch.setattr(new_organisation, "write_secret", write)
        with pytest.raises(OSError, match="No space left"):
            new_organisation.create_organisation(tmp_path, "clinic")
        assert list((tmp_path / "organisations").iterdir()) == []
    monkeypatch.undo()
    new_organisation.create_organisation(tmp_path, "clinic")
    (made,) = (tmp_path / "organisations").iterdir()
    assert stat.S_IMODE(made.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in made.glob("*key*")} == {0o600}
    files = ["admin.key", "ca.crt.pem", "ca.key.pem", "organisation-entry.json", "registrar.key"]
    assert sorted(path.name for path in made.iterdir()) == files


def test_names_that_differ_in_leading_zeros_have_one_order(handed: dict[str, Path]) -> None:
    true = made_of(*handed.values())
    first, second = (msgspec.structs.replace(true.nodes[0], name=name) for name in ("x-1", "x-01"))
    assert sorted([first, second], key=founding._by_name) == sorted([second, first], key=founding._by_name)


def test_a_network_that_would_begin_in_the_future_is_not_founded(
    world: Path, handed: dict[str, Path], tmp_path: Path
) -> None:
    """No block is later than a node's clock and its drift, so none would be made until then."""
    late = msgspec.structs.replace(made_of(*handed.values()), created_at_ms=4_102_444_800_000)
    path = tmp_path / "late.json"
    path.write_text(genesis_to_json(complete_genesis(late)))
    said = run(genesis_group, "check", str(path), "--adopt", "--dir", str(world / "university"))
    assert said.exit_code == 1
    assert "the clock of whoever made the last node's entry is wrong" in " ".join(said.stderr.split())


def test_a_file_that_was_adopted_too_early_is_replaced_until_a_node_has_started(
    world: Path, handed: dict[str, Path], tmp_path: Path
) -> None:
    early, true = made_of(*(handed[name] for name in ("clinic", "ward-2"))), made_of(*handed.values())
    home, files = tmp_path / "home", {"early": tmp_path / "early.json", "true": tmp_path / "true.json"}
    shutil.copytree(world / "clinic", home)
    node, here = home / "nodes" / "ward-2", [home / "genesis.json", home / "nodes" / "ward-2" / "genesis.json"]
    for path in here:
        path.unlink(missing_ok=True)
    for name, genesis in (("early", early), ("true", true)):
        files[name].write_text(genesis_to_json(genesis))

    def adopt(name: str) -> Result:
        return run(genesis_group, "check", str(files[name]), "--adopt", "--dir", str(home), "--json")

    for name, is_replaced in (("early", False), ("early", False), ("true", True), ("early", True)):
        said = adopt(name)
        assert said.exit_code == 0, said.output
        assert json.loads(said.stdout)["replaced"] is is_replaced
        assert {path.read_text() for path in here} == {files[name].read_text()}

    def refused(code: str, *words: str) -> None:
        said = adopt("true")
        assert said.exit_code == 1
        assert all(word in said.stdout for word in (code, *words)), said.stdout
        assert {path.read_text() for path in here} == {files["early"].read_text()}
        assert adopt("early").exit_code == 0, "the same one is no other"

    running = DirectoryLock(node)
    refused("DATA_DIRECTORY_IN_USE")
    running.release()
    (home / PIN_FILE).write_text("{}")
    refused("GENESIS_IN_USE", PIN_FILE)
    (home / PIN_FILE).unlink()
    asyncio.run(LmdbStore.create(load_config(node).ledger_dir).close())
    refused("GENESIS_IN_USE", "ward-2 has started by it", "nodes.lab-1")


def test_what_joined_later_is_no_founder_and_the_fingerprint_can_still_be_read_out(
    handed: dict[str, Path], tmp_path: Path
) -> None:
    """Where a node of a founder joins, and where an organisation does."""
    true, home = made_of(*handed.values()), tmp_path / "guest" / "network"
    home.mkdir(parents=True)
    (home / "genesis.json").write_text(genesis_to_json(true))
    assert run(org, "new", "guest", "--dir", str(home)).exit_code == 0
    authority = home / "organisations" / "guest"
    directory = content_of_genesis(true)
    organisations = {
        **directory.organisations,
        "guest": DirectoryOrganisation("guest", (authority / "ca.crt.pem").read_text()),
    }
    known = tmp_path / "directory.json"
    known.write_bytes(encode_directory(true.chain_id, replace(directory, height=7, organisations=organisations)))
    joined = ("--organisation", "guest", "--bind", "10.0.9.1", "--directory", str(known), "--dir", str(home))
    assert run(init, "desk-1", *joined).exit_code == 0
    elsewhere = tmp_path / "srv" / "desk"
    assert run(init, "desk-2", *joined, "--data-dir", str(elsewhere)).exit_code == 0

    def check(genesis: Genesis, *options: str) -> Result:
        path = tmp_path / "offered.json"
        path.write_text(genesis_to_json(genesis))
        return run(genesis_group, "check", str(path), "--dir", str(home), "--json", *options)

    for options in ((), ("--data-dir", str(elsewhere))):
        said = check(true, *options)
        assert said.exit_code == 0, said.output
        assert json.loads(said.stdout)["fingerprint"] == fingerprint(true)
    another = make_genesis(*read_offers(list(handed.values())), network="other")
    assert json.loads(check(another).stdout)["error"]["code"] == "GENESIS_DIFFERS"
    (home / "genesis.json").unlink()
    assert json.loads(check(true).stdout)["error"]["code"] == "GENESIS_DIFFERS", "it would found, and is not in it"


def test_two_files_that_differ_are_told_apart(handed: dict[str, Path]) -> None:
    true = made_of(*handed.values())
    other = make_genesis(*read_offers(list(handed.values())), network="other")
    assert 'network: "blockrobot" here, "other" there' in find_differences(true, other)
    assert fingerprint(true).replace(" ", "") == true.chain_id.hex()[:32]
    assert find_differences(true, true) == []
