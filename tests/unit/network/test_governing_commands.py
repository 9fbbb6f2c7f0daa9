"""`org`, `producer` and `settings` on the command line, in front of a consortium in memory."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

import network.cli.governance.governance_signer as governing
import network.cli.governance.quorum_check as live_quorum
from consensus.chain.genesis import genesis_to_json
from consensus.errors import CATALOGUE
from network.cli.governance.org_commands import org
from network.cli.governance.producer_commands import producer
from network.cli.governance.settings_commands import settings
from network.cli.node.certificate_commands import certificate
from network.provisioning.certificate_authority import create_authority, encode_private_key, issue_node_certificate
from network.provisioning.network_layout import create_network
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of, node_fields, producer_of


@pytest.fixture
def silent() -> set[str]:
    """The nodes that do not answer; add to it while the test runs."""
    return set()


@pytest.fixture
def chain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, silent: set[str]) -> Consortium:
    """Three organisations whose folders lie in the network's folder."""
    chain = Consortium()
    folder = tmp_path / "network"
    for name in chain.organisations:
        place = folder / "organisations" / name
        place.mkdir(parents=True)
        (place / "admin.key").write_bytes(admin_of(name).secret)
    (folder / "genesis.json").write_text(genesis_to_json(chain.genesis), encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setattr(live_quorum, "LOOK_AGAIN_S", 0)
    monkeypatch.setattr(governing, "open_pinned_client", lambda _genesis, _path: ConsortiumClient(chain, silent))
    return chain


def run(group: click.Group, *arguments: str) -> Result:
    return CliRunner().invoke(group, list(arguments))


def answer(group: click.Group, *arguments: str) -> dict[str, Any]:
    result = run(group, *arguments, "--json")
    document: dict[str, Any] = json.loads(result.stdout)
    assert document["ok"] == (result.exit_code == 0), result.output
    return document


def refusal(group: click.Group, *arguments: str) -> str:
    """The code of a refusal; in words it comes with its next step."""
    spoken = run(group, *arguments)
    assert "Next step: " in spoken.stderr
    assert spoken.exit_code != 0
    problem = answer(group, *arguments)["error"]
    assert problem["next_step"] == CATALOGUE[problem["code"]].next_step
    return str(problem["code"])


def test_a_setting_goes_from_proposal_to_force(chain: Consortium) -> None:
    proposed = run(settings, "propose", "heartbeat_ms", "9000", "--as", "org-01")
    assert "1 of the 2 organisations needed" in proposed.output
    proposal = answer(settings, "list")["proposals"][0]["id"][:12]
    assert f"settings approve {proposal} --as ORG" in proposed.output
    assert "heartbeat_ms = 9000 │ org-01" in run(settings, "list").output
    approved = run(settings, "approve", proposal, "--as", "org-03")
    assert approved.output.splitlines() == [
        "heartbeat_ms = 9000: in force since height 2.",
        "Epoch 1 begins with the block after that height.",
    ]
    assert answer(settings, "list")["settings"]["heartbeat_ms"] == 9000
    assert "No open proposals." in run(settings, "list").output


@pytest.mark.parametrize("value", ["-5", "9" * 29, "0"])
def test_a_value_out_of_range_is_refused_with_the_range_whatever_it_looks_like(chain: Consortium, value: str) -> None:
    refused = run(settings, "propose", "base_timeout_ms", value, "--as", "org-01")
    assert refused.exit_code == 4
    assert "50 to 60000" in refused.stderr


def test_a_proposal_is_taken_back_by_who_made_it(chain: Consortium) -> None:
    opened = answer(settings, "propose", "heartbeat_ms", "9000", "--as", "org-01")["proposal"]["id"]
    assert refusal(settings, "withdraw", opened, "--as", "org-02") == "GOVERNANCE_NOT_ADMIN"
    assert "Withdrawal of heartbeat_ms = 9000: in force" in run(settings, "withdraw", opened, "--as", "org-01").output
    assert refusal(settings, "approve", opened, "--as", "org-02") == "GOVERNANCE_PROPOSAL_CLOSED"


def test_what_is_proposed_already_is_pointed_to_and_not_proposed_again(chain: Consortium) -> None:
    """Two proposals of one value would share out the voices that one of them needs."""
    opened = answer(settings, "propose", "heartbeat_ms", "9000", "--as", "org-01")["proposal"]["id"][:12]
    height = chain.height
    said = run(settings, "propose", "heartbeat_ms", "9000", "--as", "org-02").stderr
    assert "heartbeat_ms = 9000 is proposed already, by org-01" in said
    assert f"Approve it: blockrobot settings approve {opened} --as org-02" in said
    said = run(settings, "propose", "heartbeat_ms", "9000", "--as", "org-01").stderr
    assert f"another organisation approves it: blockrobot settings approve {opened} --as ORG" in said
    again = ("propose", "heartbeat_ms", "9000", "--as", "org-02")
    assert refusal(settings, *again) == "GOVERNANCE_PROPOSED_ALREADY"
    assert run(settings, *again).exit_code == 1
    assert chain.height == height, "nothing was sent"
    assert answer(settings, "propose", "heartbeat_ms", "9001", "--as", "org-02")["proposal"]
    answer(settings, "approve", opened, "--as", "org-02")
    assert answer(settings, *again)["proposal"], "the first is open no more"


def test_a_change_of_members_is_not_proposed_twice_but_ones_own_certificate_is_revoked_whatever_is_open(
    chain: Consortium,
) -> None:
    revoke = ("revoke", "--serial", "0a:0b", "--of", "org-02")
    answer(certificate, *revoke, "--as", "org-01")
    assert refusal(certificate, *revoke, "--as", "org-03") == "GOVERNANCE_PROPOSED_ALREADY"
    assert answer(certificate, *revoke, "--as", "org-02")["executed"]
    opened = answer(org, "propose", "remove-node", "node-04", "--as", "org-01")["proposal"]["id"][:12]
    assert f"org approve {opened} --as org-03" in run(org, "propose", "remove-node", "node-04", "--as", "org-03").stderr
    assert answer(org, "propose", "remove-node", "node-03", "--as", "org-03")["proposal"]


def test_one_speaks_by_any_key_of_an_organisation_and_anybody_may_read(chain: Consortium, tmp_path: Path) -> None:
    result = run(settings, "propose", "heartbeat_ms", "9000")
    assert result.exit_code == 2
    assert "--as org-01 | org-02 | org-03" in result.stderr
    assert answer(org, "list")["height"] == 0
    assert refusal(settings, "propose", "heartbeat_ms", "1", "--as", "nobody") == "ORGANISATION_KEY_NOT_FOUND"
    assert refusal(org, "list", "--key", "/nowhere/admin.key") == "ORGANISATION_KEY_NOT_FOUND"
    path = tmp_path / "elsewhere.key"
    path.write_bytes(admin_of("org-02").secret)
    opened = answer(settings, "propose", "heartbeat_ms", "9000", "--key", str(path))
    assert opened["proposal"]["organisation"] == "org-02"


def test_an_organisation_that_is_not_one_yet_does_not_hinder_reading(chain: Consortium, tmp_path: Path) -> None:
    place = tmp_path / "network" / "organisations" / "aaa"
    place.mkdir()
    (place / "admin.key").write_bytes(key_of("aaa").secret)
    assert answer(org, "list")["majority"] == 2
    assert refusal(org, "list", "--as", "aaa") == "GOVERNANCE_NOT_ADMIN"


def test_without_a_network_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    for group in (org, producer, settings):
        assert refusal(group, "list") == "CLUSTER_NOT_RUNNING"


def test_a_new_organisation_is_made_proposed_and_approved(chain: Consortium, tmp_path: Path) -> None:
    made = answer(org, "new", "clinic")
    assert Path(made["folder"]).joinpath("ca.crt.pem").exists()
    assert refusal(org, "new", "clinic") == "ORGANISATION_EXISTS"
    handed_over = tmp_path / "clinic.json"
    Path(made["entry"]).rename(handed_over)
    opened = answer(org, "propose", "add-org", "--from", str(handed_over), "--as", "org-01")["proposal"]["id"]
    assert "add-org clinic" in run(org, "list").output
    answer(org, "approve", opened, "--as", "org-02")
    listed = answer(org, "list")
    assert [row["name"] for row in listed["organisations"]] == ["clinic", "org-01", "org-02", "org-03"]
    assert answer(settings, "propose", "heartbeat_ms", "1000", "--as", "clinic")["proposal"]["needed"] == 3


def test_a_node_joins_by_its_entry_and_is_voted_in(chain: Consortium, tmp_path: Path) -> None:
    fields = node_fields("node-05", "org-02")
    entry = tmp_path / "node-entry.json"
    entry.write_text(json.dumps({k: v.hex() if isinstance(v, bytes) else v for k, v in fields.items()}), "utf-8")
    opened = answer(org, "propose", "add-node", "--from", str(entry), "--as", "org-01")["proposal"]["id"]
    answer(org, "approve", opened, "--as", "org-02")
    assert "node-05" in run(org, "list").output
    said = run(producer, "propose", "node-05", "--as", "org-01")
    assert "another organisation says blockrobot producer approve node-05" in said.output
    chain.ready("node-05")
    voted = answer(producer, "approve", "node-05", "--as", "org-03")
    assert (voted["epoch"], voted["producer"]["turn"], voted["votes_needed"]) == (1, 4, 2)
    elsewhere = json.loads(entry.read_text("utf-8")) | {"name": "node-06", "api_url": "http://10.0.0.7:4101"}
    entry.write_text(json.dumps(elsewhere), "utf-8")
    assert refusal(org, "propose", "add-node", "--from", str(entry), "--as", "org-01") == "CONFIGURATION_INVALID"
    entry.write_text("[]", "utf-8")
    assert refusal(org, "propose", "add-node", "--from", str(entry), "--as", "org-01") == "FILE_UNUSABLE"


def test_the_list_of_producers_shows_seats_votes_and_the_evidence(chain: Consortium) -> None:
    chain.must(producer_of("node-01"), "producers", "accuse", *chain.evidence(producer_of("node-02")))
    answer(producer, "withdraw", "node-03", "--as", "org-02")
    answer(producer, "remove", "node-04", "--as", "org-02")
    said = run(producer, "list").output
    assert "│ 2*   │ node-02" in said
    assert "* keeps its seat and its vote, and leads nothing" in said
    assert "node-02 signed two votes in epoch 0, round 7; entered on chain at height 1" in said
    assert "producer approve NODE --as ORG" in said
    rows = {row["node"]: row for row in answer(producer, "list")["producers"]}
    assert rows["node-02"]["evidence"]["first_signature"] == rows["node-02"]["evidence"]["first_signature"].lower()
    assert rows["node-03"]["votes"] == ["org-01", "org-03"]
    assert rows["node-04"]["removals"] == ["org-02"]


def test_a_removal_tells_what_is_still_missing_and_what_the_rest_can_bear(chain: Consortium) -> None:
    said = run(producer, "remove", "node-02", "--as", "org-01").output
    assert "another organisation says blockrobot producer remove node-02" in said
    said = run(producer, "remove", "node-02", "--as", "org-03").output
    assert "Epoch 1 begins" in said
    assert "3 producers" in said
    assert "none of them may fail" in said


def test_no_producer_goes_while_too_few_of_the_others_are_well(chain: Consortium, silent: set[str]) -> None:
    """Three would be left, and all three are needed; the contracts cannot know that one of them is down."""
    silent.add("node-03")
    said = run(producer, "remove", "node-02", "--as", "org-02").stderr
    assert "3 producers would be left, and 3 of them are needed; not well now: node-03." in said
    assert refusal(producer, "remove", "node-02", "--as", "org-02") == "GOVERNANCE_QUORUM_AT_RISK"
    assert refusal(org, "propose", "remove-node", "node-02", "--as", "org-01") == "GOVERNANCE_QUORUM_AT_RISK"
    assert refusal(org, "propose", "remove-org", "org-02", "--as", "org-01") == "GOVERNANCE_QUORUM_AT_RISK"
    assert chain.height == 0, "nothing was sent"

    opened = answer(org, "propose", "remove-node", "node-02", "--as", "org-01", "--anyway")["proposal"]["id"]
    assert refusal(org, "approve", opened, "--as", "org-03") == "GOVERNANCE_QUORUM_AT_RISK"
    assert answer(org, "approve", opened, "--as", "org-03", "--anyway")["executed"]


def test_the_last_vote_is_not_withdrawn_while_too_few_of_the_others_are_well(
    chain: Consortium, silent: set[str]
) -> None:
    silent.add("node-03")
    for name in ("org-01", "org-02"):
        answer(producer, "withdraw", "node-02", "--as", name)
    assert refusal(producer, "withdraw", "node-02", "--as", "org-03") == "GOVERNANCE_QUORUM_AT_RISK"
    assert "node-02" in chain.seats
    silent.clear()
    answer(producer, "withdraw", "node-02", "--as", "org-03")
    assert "node-02" not in chain.seats


def test_the_one_that_is_down_may_be_taken_out(chain: Consortium, silent: set[str]) -> None:
    silent.add("node-03")
    for name in ("org-01", "org-02"):
        answer(producer, "remove", "node-03", "--as", name)
    assert chain.seats == ["node-01", "node-02", "node-04"]


def test_who_is_no_producer_may_go_whoever_is_down(chain: Consortium, silent: set[str], tmp_path: Path) -> None:
    chain.agree("add_node", node_fields("node-05", "org-02"))
    silent.update({"node-01", "node-02"})
    opened = answer(org, "propose", "remove-node", "node-05", "--as", "org-01")["proposal"]["id"]
    assert answer(org, "approve", opened, "--as", "org-02")["executed"]


def test_a_node_moves_only_to_where_its_certificate_says(chain: Consortium, tmp_path: Path) -> None:
    """A certificate of a node whose folder is elsewhere is not looked at."""
    create_network(tmp_path / "made", nodes=1, organisations=1, base_port=20_000)
    move = ("propose", "move-node", "node-01", "--as", "org-01", "--advertise")
    (tmp_path / "network" / "nodes").mkdir()
    shutil.move(tmp_path / "made" / "nodes" / "node-1", tmp_path / "network" / "nodes" / "node-01")
    said = run(org, *move, "10.0.0.9:7272").stderr
    assert "does not name 10.0.0.9." in said
    assert "First: blockrobot certificate renew node-01 --host 10.0.0.9 (and" in said
    assert refusal(org, *move, "10.0.0.9:7272") == "CERTIFICATE_UNFIT"
    assert chain.height == 0, "nothing was sent"
    said = run(org, *move, "127.0.0.1:7272")
    assert "node-01 listens at 127.0.0.1:20000" in said.stderr
    assert "blockrobot down node-01; blockrobot node run node-01 --detach" in said.stderr
    assert "listens at" not in run(org, *move, "127.0.0.1:20000").stderr, "it does so already"
    shutil.rmtree(tmp_path / "network" / "nodes")
    assert answer(org, *move, "10.0.0.9:7272")["executed"]


def test_an_entry_is_that_of_whom_one_names_and_a_producer_is_named_by_node_or_key(chain: Consortium) -> None:
    entry = answer(org, "new", "clinic")["entry"]
    assert refusal(org, "propose", "add-org", "other", "--from", entry, "--as", "org-01") == "FILE_UNUSABLE"
    assert run(org, "propose", "add-org", "--as", "org-01").exit_code == 2
    assert refusal(org, "propose", "add-org", "nowhere", "--as", "org-01") == "FILE_UNUSABLE"
    key = producer_of("node-03").public_key.hex()
    answer(producer, "withdraw", key, "--as", "org-01")
    answer(producer, "withdraw", key[:10], "--as", "org-02")
    assert refusal(producer, "withdraw", "node-99", "--as", "org-01") == "NOT_FOUND"
    assert refusal(producer, "withdraw", "02", "--as", "org-01") == "NOT_FOUND"


def test_organisations_nodes_keys_and_certificates_are_changed(chain: Consortium, tmp_path: Path) -> None:
    authority = create_authority("org-02")
    ca_file = tmp_path / "ca.crt.pem"
    ca_file.write_text(authority.certificate_pem, encoding="utf-8")
    issued = issue_node_certificate(authority, "node-02")
    (tmp_path / "tls.crt.pem").write_bytes(issued.certificate_pem)
    (tmp_path / "new.key").write_bytes(key_of("new").secret)
    new_admin = key_of("new-admin").public_key
    changes = [
        ("replace-ca", "org-02", "--certificate", str(ca_file)),
        ("rekey-producer", "node-02", "--producer-key", str(tmp_path / "new.key")),
        ("remove-node", "node-04"),
        ("replace-keys", "org-03", "--admin", new_admin.hex()),
    ]
    for change in changes:
        opened = answer(org, "propose", *change, "--as", "org-01")["proposal"]["id"]
        assert answer(org, "approve", opened, "--as", "org-02")["executed"]
    assert chain.value("membership", b"org/org-02")["ca_certificate"] == authority.certificate_pem
    assert chain.value("membership", b"node/node-02")["producer_key"] == key_of("new").public_key
    assert chain.value("membership", b"node/node-04")["status"] == "removed"
    assert chain.view("identity", "admin_of", new_admin) == "org-03"

    assert refusal(certificate, "revoke", "--serial", "ZZ", "--as", "org-02") == "SERIAL_INVALID"
    own = run(certificate, "revoke", "--certificate", str(tmp_path / "tls.crt.pem"), "--as", "org-02")
    assert "in force since height" in own.output
    assert chain.value("membership", b"revoked/org-02/" + issued.serial.to_bytes(20, "big")) is not None
    assert run(certificate, "revoke", "--as", "org-02").exit_code == 2
    opened = answer(org, "propose", "remove-org", "org-01", "--as", "org-02")["proposal"]["id"]
    answer(org, "withdraw", opened, "--as", "org-02")


def test_anothers_certificate_is_revoked_by_a_majority_ones_own_at_once(chain: Consortium) -> None:
    revoke = ("revoke", "--serial", "0a:0b", "--of", "org-02")
    opened = answer(certificate, *revoke, "--as", "org-01")["proposal"]["id"]
    place = b"revoked/org-02/" + (0x0A0B).to_bytes(20, "big")
    assert chain.value("membership", place) is None
    assert answer(org, "approve", opened, "--as", "org-03")["executed"]
    assert chain.value("membership", place) is not None


def test_an_authority_is_proposed_and_approved_only_if_it_is_one_and_no_others(
    chain: Consortium, tmp_path: Path
) -> None:
    first, second = create_authority("org-01"), create_authority("org-02")
    chain.agree("replace_ca", {"organisation": "org-01", "ca_certificate": first.certificate_pem})
    height = chain.height
    path = tmp_path / "ca.crt.pem"
    change = ("propose", "replace-ca", "org-02", "--certificate", str(path), "--as", "org-03")
    leaf = issue_node_certificate(second, "node-02").certificate_pem.decode()
    for unfit in (first.certificate_pem, create_authority("org-03").certificate_pem, leaf):
        path.write_text(second.certificate_pem + unfit, "ascii")
        assert refusal(org, *change) == "AUTHORITY_INVALID"
    path.write_text(first.certificate_pem, "ascii")
    assert "that of org-01, not of org-02" in run(org, *change).stderr
    newcomer = Path(answer(org, "new", "clinic")["entry"])
    newcomer.write_text(json.dumps(json.loads(newcomer.read_text("utf-8")) | {"ca_certificate": leaf}), "utf-8")
    assert refusal(org, "propose", "add-org", "clinic", "--as", "org-01") == "AUTHORITY_INVALID"
    assert chain.height == height, "nothing was sent"

    arguments = {"organisation": "org-02", "ca_certificate": first.certificate_pem}
    smuggled = chain.must(admin_of("org-03"), "membership", "propose", "replace_ca", arguments).txid
    assert refusal(org, "approve", smuggled.hex(), "--as", "org-02") == "AUTHORITY_INVALID"
    path.write_text(second.certificate_pem, "ascii")
    assert answer(org, *change)["proposal"]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """What people keep in one file: a certificate and its key."""
    authority = create_authority("org-02")
    path = tmp_path / "bundle.pem"
    path.write_bytes(authority.certificate_pem.encode() + encode_private_key(authority.key))
    return path


def test_a_private_key_is_never_proposed(chain: Consortium, tmp_path: Path, bundle: Path) -> None:
    said = run(org, "propose", "replace-ca", "org-02", "--certificate", str(bundle), "--as", "org-01")
    assert str(bundle) in said.stderr.replace("\n", "")
    replaced = refusal(org, "propose", "replace-ca", "org-02", "--certificate", str(bundle), "--as", "org-01")
    assert replaced == "FILE_HOLDS_PRIVATE_KEY"
    entry = Path(answer(org, "new", "clinic")["entry"])
    document = json.loads(entry.read_text("utf-8"))
    entry.write_text(json.dumps(document | {"ca_certificate": bundle.read_text("ascii")}), "utf-8")
    assert refusal(org, "propose", "add-org", "clinic", "--as", "org-01") == "FILE_HOLDS_PRIVATE_KEY"
    assert chain.height == 0, "nothing was sent"


def test_fewer_seats_are_not_decided_while_too_few_of_those_left_are_well(chain: Consortium, silent: set[str]) -> None:
    """Of four producers the youngest key goes; of the three left, all are needed."""
    lowest = sorted(chain.epoch.producers)
    silent.add(chain.candidate(lowest[0])["name"])
    assert refusal(settings, "propose", "max_producers", "3", "--as", "org-01") == "GOVERNANCE_QUORUM_AT_RISK"
    opened = answer(settings, "propose", "max_producers", "3", "--as", "org-01", "--anyway")["proposal"]["id"]
    assert refusal(settings, "approve", opened, "--as", "org-02") == "GOVERNANCE_QUORUM_AT_RISK"
    silent.clear()
    assert answer(settings, "approve", opened, "--as", "org-02")["executed"]
    assert sorted(chain.epoch.producers) == lowest[:3]


def test_who_is_cut_off_by_fewer_seats_may_be_unwell(chain: Consortium, silent: set[str]) -> None:
    silent.add(chain.candidate(max(chain.epoch.producers))["name"])
    answer(settings, "propose", "max_producers", "3", "--as", "org-01")
    assert answer(settings, "propose", "max_producers", "21", "--as", "org-01")["ok"]


def test_a_producer_key_is_not_replaced_while_the_others_cannot_do_without_the_node(
    chain: Consortium, silent: set[str], tmp_path: Path
) -> None:
    (tmp_path / "new.key").write_bytes(key_of("new").secret)
    change = ("propose", "rekey-producer", "node-02", "--producer-key", str(tmp_path / "new.key"), "--as", "org-01")
    silent.add("node-03")
    said = run(org, *change).stderr
    assert "4 producers would be left, and 3 of them are needed" in said
    assert "node-02 (until it has its new key), node-03." in said
    opened = answer(org, *change, "--anyway")["proposal"]["id"]
    assert refusal(org, "approve", opened, "--as", "org-02") == "GOVERNANCE_QUORUM_AT_RISK"
    silent.clear()
    assert answer(org, "approve", opened, "--as", "org-02")["executed"]


def test_an_organisation_that_holds_the_last_vote_for_others_is_not_let_go_unlooked(
    chain: Consortium, silent: set[str]
) -> None:
    """With org-03 its own node goes, and so does the one that nobody else votes for."""
    for name in ("org-01", "org-02"):
        chain.must(admin_of(name), "producers", "withdraw", producer_of("node-02").public_key)
    silent.add("node-04")
    said = run(org, "propose", "remove-org", "org-03", "--as", "org-01").stderr
    assert "2 producers would be left, and 2 of them are needed; not well now: node-04." in said


def test_keys_that_nobody_can_have_are_refused_before_they_are_sent(chain: Consortium, tmp_path: Path) -> None:
    for option in ("--admin", "--registrar"):
        keys = ["--admin", key_of("new").public_key.hex(), option, "02" + "ff" * 32]
        result = run(org, "propose", "replace-keys", "org-03", *keys, "--as", "org-01")
        assert result.exit_code == 2
        assert f"{option} takes a public key" in result.stderr
    fields = {**node_fields("node-05", "org-02"), "custodian_key": bytes(33)}
    entry = tmp_path / "node-entry.json"
    entry.write_text(json.dumps({k: v.hex() if isinstance(v, bytes) else v for k, v in fields.items()}), "utf-8")
    assert refusal(org, "propose", "add-node", "--from", str(entry), "--as", "org-01") == "FILE_UNUSABLE"
    assert chain.height == 0


def test_a_list_shows_only_the_approvals_that_still_count(chain: Consortium) -> None:
    answer(settings, "propose", "heartbeat_ms", "9000", "--as", "org-03")
    fresh = {"organisation": "org-03", "admins": [key_of("fresh").public_key], "registrars": []}
    chain.agree("replace_keys", fresh)
    (proposal,) = answer(settings, "list", "--as", "org-01")["proposals"]
    assert proposal["approvals"] == []
