"""Membership: organisations and nodes come and go by a majority of the organisations, each with one voice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from consensus.chain.genesis import prove_possession
from consensus.primitives.keys import PrivateKey, is_public_key
from tests.unit.contracts.system.consortium import (
    CERTIFICATE,
    DAY_MS,
    Consortium,
    admin_of,
    data_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)


def test_the_first_state_holds_every_organisation_and_node(consortium: Consortium) -> None:
    assert consortium.active() == ["org-01", "org-02", "org-03"]
    assert consortium.value("membership", b"org/org-02") == {
        "name": "org-02",
        "ca_certificate": CERTIFICATE,
        "status": "active",
        "since_height": 0,
    }
    node = consortium.value("membership", b"node/node-04")
    assert node == {**node_fields("node-04", "org-01"), "status": "active", "since_height": 0}
    assert consortium.view("membership", "list_nodes") == ["node-01", "node-02", "node-03", "node-04"]


def test_a_new_organisation_enters_with_the_second_of_three_voices(consortium: Consortium) -> None:
    proposed = consortium.must(admin_of("org-01"), "membership", "propose", "add_org", organisation_fields("org-04"))
    assert consortium.active() == ["org-01", "org-02", "org-03"]
    consortium.must(admin_of("org-03"), "membership", "approve", proposed.txid)
    assert consortium.active() == ["org-01", "org-02", "org-03", "org-04"]
    proposal = consortium.view("membership", "proposal", proposed.txid)
    assert (proposal["status"], proposal["approvals"]) == ("executed", ["org-01", "org-03"])
    assert consortium.view("membership", "proposals") == []
    consortium.must(admin_of("org-04"), "settings", "propose", "heartbeat_ms", 9000)
    assert consortium.view("identity", "admin_of", admin_of("org-04").public_key) == "org-04"
    assert consortium.value("identity", b"registrar/" + key_of("org-04/registrar").public_key) == "org-04"


def test_an_organisation_has_one_voice_whichever_admin_speaks(consortium: Consortium) -> None:
    second = key_of("org-01/second-admin")
    keys = {"organisation": "org-01", "admins": [admin_of("org-01").public_key, second.public_key], "registrars": []}
    consortium.agree("replace_keys", keys)
    proposed = consortium.must(admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-04"})
    for key in (admin_of("org-01"), second):
        consortium.refused("APPROVED_ALREADY", key, "membership", "approve", proposed.txid)
    assert consortium.value("membership", b"node/node-04")["status"] == "active"


def test_a_proposal_expires_after_seven_days(consortium: Consortium) -> None:
    proposed = consortium.must(admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-04"})
    consortium.time_ms += 7 * DAY_MS
    consortium.refused("PROPOSAL_EXPIRED", admin_of("org-02"), "membership", "approve", proposed.txid)
    consortium.must(admin_of("org-02"), "membership", "propose", "remove_node", {"name": "node-04"})
    assert consortium.view("membership", "proposal", proposed.txid)["status"] == "expired"
    consortium.refused("PROPOSAL_CLOSED", admin_of("org-02"), "membership", "approve", proposed.txid)


def test_open_proposals_are_bounded_and_may_be_taken_back(consortium: Consortium) -> None:
    def propose(number: int) -> list[Any]:
        return ["revoke_certificate", {"organisation": "org-02", "serial": number.to_bytes(20, "big")}]

    first = consortium.must(admin_of("org-01"), "membership", "propose", *propose(1))
    for number in range(2, 5):
        consortium.must(admin_of("org-01"), "membership", "propose", *propose(number))
    consortium.refused("PROPOSALS_TOO_MANY", admin_of("org-01"), "membership", "propose", *propose(5))
    consortium.refused("PROPOSALS_TOO_MANY", admin_of("org-01"), "settings", "propose", "heartbeat_ms", 9)
    consortium.refused("NOT_THE_PROPOSER", admin_of("org-02"), "membership", "withdraw", first.txid)
    consortium.must(admin_of("org-01"), "membership", "withdraw", first.txid)
    consortium.must(admin_of("org-01"), "membership", "propose", *propose(5))
    consortium.refused("PROPOSAL_CLOSED", admin_of("org-02"), "membership", "approve", first.txid)


def test_only_the_last_closed_proposals_are_kept(consortium: Consortium) -> None:
    ids = []
    for number in range(40):
        fields = {"organisation": "org-01", "serial": number.to_bytes(20, "big")}
        ids.append(consortium.must(admin_of("org-01"), "membership", "propose", "revoke_certificate", fields).txid)
    assert consortium.value("membership", b"closed") == ids[-32:]
    assert consortium.view("membership", "proposal", ids[0]) is None
    assert consortium.view("membership", "proposal", ids[-1])["status"] == "executed"


def test_a_removed_organisation_leaves_with_its_nodes_keys_and_voice() -> None:
    chain = Consortium(organisations=3, nodes=6)
    assert chain.value("identity", b"registrar/" + key_of("org-02/registrar").public_key) == "org-02"
    chain.agree("remove_org", {"name": "org-02"})
    assert chain.active() == ["org-01", "org-03"]
    assert chain.seats == ["node-01", "node-03", "node-04", "node-06"]
    for name in ("node-02", "node-05"):
        node = chain.value("membership", b"node/" + name.encode())
        assert (node["status"], node["since_height"]) == ("removed", chain.height)
        assert chain.candidate(producer_of(name).public_key)["status"] == "removed"
    assert chain.value("identity", b"registrar/" + key_of("org-02/registrar").public_key) is None
    assert key_of("node-02/custodian").public_key not in chain.value("identity", b"custodians")
    chain.refused("NOT_AN_ADMIN", admin_of("org-02"), "producers", "approve", producer_of("node-01").public_key)


def test_an_approval_of_a_removed_organisation_counts_no_more() -> None:
    chain = Consortium(organisations=5, nodes=5)
    proposed = chain.must(admin_of("org-05"), "settings", "propose", "heartbeat_ms", 7000)
    chain.agree("remove_org", {"name": "org-05"})
    for name in ("org-01", "org-02"):
        chain.must(admin_of(name), "settings", "approve", proposed.txid)
    assert chain.epoch.settings.heartbeat_ms == 30_000
    chain.must(admin_of("org-03"), "settings", "approve", proposed.txid)
    assert chain.epoch.settings.heartbeat_ms == 7000


def _let_go_and_in_again(chain: Consortium, name: str) -> PrivateKey:
    """Remove an organisation, and add it with a fresh key; return that."""
    fresh = key_of(name + "/fresh-admin")
    chain.agree("remove_org", {"name": name})
    chain.agree("add_org", {**organisation_fields(name), "admins": [fresh.public_key]})
    return fresh


def _replace_key(chain: Consortium, name: str) -> PrivateKey:
    fresh = key_of(name + "/fresh-admin")
    chain.agree("replace_keys", {"organisation": name, "admins": [fresh.public_key], "registrars": []})
    return fresh


RENEWALS = [_let_go_and_in_again, _replace_key]


@pytest.mark.parametrize("renew", RENEWALS)
def test_a_voice_ends_with_the_keys_that_gave_it(renew: Callable[[Consortium, str], PrivateKey]) -> None:
    """A thief approved with a stolen key; the organisation got new ones, and has not approved."""
    chain = Consortium(organisations=5, nodes=5)
    proposed = chain.must(admin_of("org-04"), "settings", "propose", "heartbeat_ms", 7000)
    chain.must(admin_of("org-05"), "settings", "approve", proposed.txid)
    fresh = renew(chain, "org-05")
    chain.must(admin_of("org-01"), "settings", "approve", proposed.txid)
    assert chain.epoch.settings.heartbeat_ms == 30_000
    proposal = chain.view("membership", "proposal", proposed.txid)
    assert (proposal["status"], proposal["approvals"]) == ("open", ["org-04", "org-01"])
    chain.must(fresh, "settings", "approve", proposed.txid)
    assert chain.epoch.settings.heartbeat_ms == 7000


@pytest.mark.parametrize("renew", RENEWALS)
def test_votes_for_newcomers_and_removals_end_with_the_keys_that_gave_them(
    renew: Callable[[Consortium, str], PrivateKey],
) -> None:
    chain = Consortium(organisations=5, nodes=5)
    chain.agree("add_node", node_fields("node-06", "org-04"))
    newcomer, other = producer_of("node-06").public_key, producer_of("node-01").public_key
    chain.must(admin_of("org-04"), "producers", "propose", newcomer)
    for name in ("org-03", "org-05"):
        chain.must(admin_of(name), "producers", "approve", newcomer)
    chain.must(admin_of("org-05"), "producers", "remove", other)
    fresh = renew(chain, "org-05")
    chain.ready("node-06")
    assert chain.candidate(newcomer)["votes"] == ["org-04", "org-03"]
    assert chain.candidate(other)["removals"] == []
    assert "node-06" not in chain.seats
    chain.must(fresh, "producers", "approve", newcomer)
    assert "node-06" in chain.seats


def test_new_keys_of_an_organisation_cost_no_producer_its_seat(consortium: Consortium) -> None:
    kept = producer_of("node-02").public_key
    for name in ("org-01", "org-03"):
        consortium.must(admin_of(name), "producers", "withdraw", kept)
    fresh = _replace_key(consortium, "org-02")
    assert consortium.candidate(kept)["votes"] == ["org-02"]
    assert "node-02" in consortium.seats
    consortium.must(fresh, "producers", "withdraw", kept)
    assert "node-02" not in consortium.seats


@pytest.mark.parametrize(
    "key",
    [
        bytes(33),
        b"\x02" + bytes(32),
        b"\x04" + key_of("x").public_key[1:],
        b"\x02" + b"\xff" * 32,
        b"\x02" + bytes(31) + b"\x05",
    ],
)
def test_a_key_that_nobody_can_have_is_refused(consortium: Consortium, key: bytes) -> None:
    """An organisation with such a key would have a voice, count for the majority, and never speak."""
    assert not is_public_key(key)
    newcomer = {**organisation_fields("org-04"), "admins": [key]}
    consortium.refused("KEY_WRONG", admin_of("org-01"), "membership", "propose", "add_org", newcomer)
    for admins, registrars in (([key], []), ([key_of("new").public_key], [key])):
        fields = {"organisation": "org-02", "admins": admins, "registrars": registrars}
        consortium.refused("KEY_WRONG", admin_of("org-01"), "membership", "propose", "replace_keys", fields)


def test_the_last_admin_producer_and_custodian_stay() -> None:
    chain = Consortium(organisations=1, nodes=1)
    chain.refused("LAST_ADMINS", admin_of("org-01"), "membership", "propose", "remove_org", {"name": "org-01"})
    chain = Consortium(organisations=1, nodes=2)
    chain.refused("LAST_CUSTODIAN", admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-01"})
    chain.agree("remove_node", {"name": "node-02"})
    chain.agree("add_node", node_fields("node-03", "org-01", custodian=True))
    chain.refused("LAST_PRODUCER", admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-01"})
    assert chain.seats == ["node-01"]


def test_a_node_joins_as_custodian_and_leaves_by_its_own_name_for_ever(consortium: Consortium) -> None:
    fields = node_fields("node-05", "org-02", custodian=True)
    consortium.agree("add_node", fields)
    assert fields["custodian_key"] in consortium.view("identity", "custodians")
    assert consortium.epoch.number == 0, "a node is no producer before it is voted in"
    consortium.agree("remove_node", {"name": "node-05"})
    assert fields["custodian_key"] not in consortium.view("identity", "custodians")
    again = node_fields("node-05", "org-02", key=key_of("another"))
    consortium.refused("NODE_NAME_USED", admin_of("org-01"), "membership", "propose", "add_node", again)


def test_a_node_must_prove_its_producer_key_and_share_none(consortium: Consortium) -> None:
    good = node_fields("node-05", "org-02")
    other = producer_of("node-01")
    taken = {"producer_key": other.public_key, "producer_possession": prove_possession(other, "node-05")}
    wrong = [
        ("POSSESSION_WRONG", {"producer_possession": prove_possession(producer_of("node-05"), "node-06")}),
        ("POSSESSION_WRONG", {"producer_possession": prove_possession(key_of("thief"), "node-05")}),
        ("POSSESSION_WRONG", {"producer_possession": b""}),
        ("POSSESSION_WRONG", {"producer_key": b""}),
        ("KEY_TAKEN", taken),
        ("KEY_TAKEN", {"custodian_key": key_of("node-01/custodian").public_key}),
        ("KEY_TAKEN", {"custodian_key": good["producer_key"]}),
        ("KEY_SIZE_WRONG", {"custodian_key": bytes(32)}),
        ("KEY_WRONG", {"custodian_key": bytes(33)}),
        ("ORGANISATION_UNKNOWN", {"organisation": "org-09"}),
        ("NAME_WRONG", {"name": "Node 5"}),
        ("NAME_WRONG", {"name": "n" * 41}),
        ("HOST_WRONG", {"host": ""}),
        ("HOST_WRONG", {"host": "node\x1b]0;mine\x07"}),
        ("HOST_WRONG", {"host": "node..example"}),
        ("HOST_WRONG", {"host": "node.example."}),
        ("HOST_WRONG", {"host": "h" * 64 + ".example"}),
        ("HOST_WRONG", {"host": "-node.example"}),
        ("HOST_WRONG", {"host": "node-.example"}),
        ("HOST_WRONG", {"host": "[fd00::1]"}),
        ("HOST_WRONG", {"host": "fe80::1%eth0"}),
        ("HOST_WRONG", {"host": "h." * 126 + "hh"}),
        ("URL_WRONG", {"api_url": "https://" + "h" * 64}),
        ("URL_WRONG", {"api_url": "https://node..example"}),
        ("URL_WRONG", {"api_url": "https://"}),
        ("URL_WRONG", {"api_url": "https://node.example/"}),
        ("URL_WRONG", {"api_url": "https://node.example/path"}),
        ("URL_WRONG", {"api_url": "https://node.example?q"}),
        ("URL_WRONG", {"api_url": "https://node.example#f"}),
        ("URL_WRONG", {"api_url": "https://who@node.example"}),
        ("URL_WRONG", {"api_url": "https://node.example:"}),
        ("URL_WRONG", {"api_url": "https://node.example:4x"}),
        ("URL_WRONG", {"api_url": "https://node.example:123456"}),
        ("URL_WRONG", {"api_url": "https://node.example:65536"}),
        ("URL_WRONG", {"api_url": "https://[fd00::1]:99999"}),
        ("URL_WRONG", {"api_url": "https://node.example:0"}),
        ("URL_WRONG", {"api_url": "https://[fd00::1"}),
        ("URL_WRONG", {"api_url": "https://[node]:1"}),
        ("URL_WRONG", {"api_url": "https://[fd00::1]x"}),
        ("URL_WRONG", {"api_url": "https://fd00::1"}),
        ("URL_WRONG", {"api_url": "https://node\x1b[2J"}),
        ("URL_WRONG", {"api_url": "https://node\u202e"}),
        ("PORT_WRONG", {"p2p_port": 65_536}),
        ("URL_WRONG", {"api_url": "ftp://127.0.0.1"}),
        ("FIELDS_WRONG", {"p2p_port": "4100"}),
        ("FIELDS_WRONG", {"more": 1}),
    ]
    for code, change in wrong:
        consortium.refused(code, admin_of("org-01"), "membership", "propose", "add_node", {**good, **change})
    consortium.agree("add_node", good)


def test_a_rekeyed_producer_keeps_its_place_and_the_old_key_counts_no_more(consortium: Consortium) -> None:
    old, new = producer_of("node-02").public_key, key_of("new")
    fields = {
        "node": "node-02",
        "producer_key": new.public_key,
        "producer_possession": prove_possession(new, "node-02"),
    }
    receipt = consortium.agree("rekey_producer", fields)
    assert consortium.epoch.producers[1] == new.public_key
    assert consortium.boundaries == [(consortium.height, consortium.epoch)]
    assert consortium.value("membership", b"node/node-02")["producer_key"] == new.public_key
    assert consortium.candidate(old)["status"] == "removed"
    assert consortium.candidate(new.public_key)["votes"] == ["org-01", "org-02", "org-03"]
    assert data_of(receipt, "rekeyed")["new"] == new.public_key
    height, root = consortium.height, consortium.state.state_root
    consortium.refused("CANDIDATE_UNKNOWN", producer_of("node-02"), "producers", "ready", height, root)
    consortium.refused("NODE_UNKNOWN", admin_of("org-01"), "producers", "propose", old)
    proof = prove_possession(producer_of("node-02"), "node-02")
    back = {"node": "node-02", "producer_key": old, "producer_possession": proof}
    consortium.refused("KEY_TAKEN", admin_of("org-01"), "membership", "propose", "rekey_producer", back)


def test_an_organisation_moves_its_own_node_alone_but_no_others(consortium: Consortium) -> None:
    before = consortium.value("membership", b"node/node-01")
    owner = before["organisation"]
    place = {"host": "node-01.clinic.example", "p2p_port": 7272, "api_url": "https://node-01.clinic.example:7273"}
    consortium.must(admin_of(owner), "membership", "propose", "move_node", {"name": "node-01", **place})
    assert consortium.value("membership", b"node/node-01") == {**before, **place}
    other = {"name": "node-02", **place}
    assert consortium.value("membership", b"node/node-02")["organisation"] != owner
    proposed = consortium.must(admin_of(owner), "membership", "propose", "move_node", other)
    assert consortium.value("membership", b"node/node-02")["host"] != place["host"]
    consortium.must(admin_of("org-03"), "membership", "approve", proposed.txid)
    assert consortium.value("membership", b"node/node-02")["host"] == place["host"]
    for code, change in (
        ("NODE_UNKNOWN", {"name": "node-77"}),
        ("HOST_WRONG", {"host": ""}),
        ("HOST_WRONG", {"host": "a b"}),
        ("HOST_WRONG", {"host": "a..b"}),
        ("PORT_WRONG", {"p2p_port": 0}),
        ("URL_WRONG", {"api_url": "ftp://x"}),
        ("URL_WRONG", {"api_url": "http://127.0.0.1:80"}),
        ("FIELDS_WRONG", {"p2p_port": "1"}),
    ):
        wrong = {"name": "node-01", **place, **change}
        consortium.refused(code, admin_of(owner), "membership", "propose", "move_node", wrong)
    consortium.refused("NOT_AN_ADMIN", key_of("org-01/registrar"), "membership", "propose", "move_node", other)


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("fd00::1", "https://[fd00::1]:1"),
        ("10.0.0.7", "https://10.0.0.7"),
        ("ward_1.example", "http://127.0.0.1:7273"),
        ("h." * 126 + "h", "https://" + "u" * 63 + ".example:65535"),
    ],
)
def test_a_node_is_entered_where_clients_would_look_for_it(consortium: Consortium, host: str, url: str) -> None:
    consortium.agree("add_node", {**node_fields("node-05", "org-02"), "host": host, "api_url": url})
    assert consortium.value("membership", b"node/node-05")["host"] == host


def test_an_organisation_revokes_its_own_certificate_alone_but_no_others(consortium: Consortium) -> None:
    serial = (77).to_bytes(20, "big")
    own = {"organisation": "org-01", "serial": serial}
    consortium.must(admin_of("org-01"), "membership", "propose", "revoke_certificate", own)
    assert consortium.value("membership", b"revoked/org-01/" + serial) == {"height": consortium.height}
    consortium.refused("CERTIFICATE_REVOKED", admin_of("org-01"), "membership", "propose", "revoke_certificate", own)
    others = {"organisation": "org-02", "serial": serial}
    proposed = consortium.must(admin_of("org-01"), "membership", "propose", "revoke_certificate", others)
    assert consortium.value("membership", b"revoked/org-02/" + serial) is None
    consortium.must(admin_of("org-03"), "membership", "approve", proposed.txid)
    assert consortium.value("membership", b"revoked/org-02/" + serial) == {"height": consortium.height}


def test_a_certificate_authority_is_replaced(consortium: Consortium) -> None:
    certificate = CERTIFICATE.replace("MIIB", "MIIC")
    consortium.agree("replace_ca", {"organisation": "org-03", "ca_certificate": certificate})
    entry = consortium.value("membership", b"org/org-03")
    assert (entry["ca_certificate"], entry["since_height"]) == (certificate, consortium.height)
    wrong = {"organisation": "org-03", "ca_certificate": "no certificate"}
    consortium.refused("CERTIFICATE_WRONG", admin_of("org-01"), "membership", "propose", "replace_ca", wrong)


def test_new_keys_of_an_organisation_put_the_old_ones_out_of_use(consortium: Consortium) -> None:
    new = key_of("org-02/new-admin")
    fields = {"organisation": "org-02", "admins": [new.public_key], "registrars": []}
    consortium.agree("replace_keys", fields)
    consortium.refused("NOT_AN_ADMIN", admin_of("org-02"), "settings", "propose", "heartbeat_ms", 1)
    consortium.must(new, "settings", "propose", "heartbeat_ms", 1)
    taken = {"organisation": "org-02", "admins": [admin_of("org-01").public_key], "registrars": []}
    proposed = consortium.must(new, "membership", "propose", "replace_keys", taken)
    consortium.refused("KEY_OF_ANOTHER", admin_of("org-01"), "membership", "approve", proposed.txid)


def test_what_can_no_longer_take_effect_is_refused_when_the_majority_is_reached(consortium: Consortium) -> None:
    proposed = consortium.must(admin_of("org-01"), "membership", "propose", "remove_node", {"name": "node-04"})
    consortium.agree("remove_node", {"name": "node-04"})
    consortium.refused("NODE_UNKNOWN", admin_of("org-02"), "membership", "approve", proposed.txid)
    setting = consortium.must(admin_of("org-01"), "settings", "propose", "heartbeat_ms", 1000).txid
    consortium.refused("PROPOSAL_OF_ANOTHER", admin_of("org-02"), "membership", "approve", setting)


@pytest.mark.parametrize(
    "arguments", [["nothing", {}], ["add_org", {}], ["add_org", {"name": 1}], ["remove_org", {"x": ""}]]
)
def test_nonsense_is_refused_with_a_sentence(consortium: Consortium, arguments: list[Any]) -> None:
    receipt = consortium.send(admin_of("org-01"), "membership", "propose", *arguments)
    assert receipt.code in {"KIND_UNKNOWN", "FIELDS_WRONG"}
