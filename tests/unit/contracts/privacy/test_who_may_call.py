"""Every entry that changes something, tried by everyone who may not call it: nothing but a receipt remains."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from consensus.primitives.keys import PrivateKey
from contracts.execution.registry import PRIVACY_CONTRACTS
from tests.unit.contracts.privacy.hospital import Hospital, Visit, key_of


class Scene:
    """A visit with a record, an access request and an erasure request, and everybody who might meddle."""

    def __init__(self, hospital: Hospital) -> None:
        self.hospital = hospital
        self.anna, self.ben = hospital.enrol("anna"), hospital.enrol("ben")
        self.other_robot = hospital.enrol("other-robot", "robot")
        self.visit: Visit = hospital.open_visit(self.anna)
        self.others_visit = hospital.open_visit(self.ben)
        self.record_id = hospital.record(self.visit)
        self.erased_id = hospital.record(self.visit)
        self.access_id = hospital.must(self.visit.key, "access", "request", [self.record_id], "own-access").txid
        self.erasure_id = hospital.must(self.visit.key, "erasure", "request", [self.erased_id], []).txid
        self.denied = hospital.open_visit(self.ben, 1)
        self.denied_id = hospital.record(self.denied)
        self.breach_id = hospital.must(self.denied.key, "rights", "wrong_person").txid
        officer = hospital.enrol("officer", "officer").identity
        hospital.must(officer, "rights", "assess", self.breach_id, "none", "matched-wrongly")
        hospital.must(self.visit.key, "rights", "restrict", [self.record_id], "accuracy")
        self.everyone: dict[str, PrivateKey] = {
            "anna": self.anna.identity,
            "ben": self.ben.identity,
            "owner": self.visit.key,
            "other-owner": self.others_visit.key,
            "robot": hospital.robot.identity,
            "other-robot": self.other_robot.identity,
            "staff": hospital.enrol("staff", "staff").identity,
            "officer": officer,
            "denied-owner": self.denied.key,
            "auditor": hospital.enrol("auditor", "auditor").identity,
            "registrar": hospital.registrar,
            "admin": hospital.admin,
            "custodian": hospital.custodians[0],
            "stranger": key_of("stranger"),
        }


def _open(scene: Scene) -> list[Any]:
    return scene.hospital.visit_of(scene.ben, 9)[1]


def _record(scene: Scene) -> list[Any]:
    return scene.hospital.record_arguments(scene.visit, 9)


Arguments = Callable[[Scene], list[Any]]
RULES: list[tuple[str, str, Arguments, set[str]]] = [
    ("identity", "authenticate", lambda s: [s.anna.handle], {"anna"}),
    ("identity", "leave", lambda s: [s.anna.handle], {"anna"}),
    ("identity", "revoke", lambda s: [s.anna.handle], {"registrar", "admin"}),
    ("identity", "rotate", lambda s: [s.anna.handle, bytes(33), bytes(33), bytes(33), bytes(32), bytes(65)], set()),
    ("identity", "genesis", lambda _: [[], [], []], set()),
    ("identity", "put_organisation", lambda _: ["ward", [bytes(33)], []], set()),
    ("identity", "remove_organisation", lambda _: ["ward"], set()),
    ("identity", "add_custodian", lambda _: [bytes(33), "node", "ward"], set()),
    ("identity", "remove_custodians", lambda _: [[]], set()),
    ("consent", "give", lambda s: [s.anna.handle, ["care"], ["rgb"], 0, 0, 0, 0], {"anna"}),
    ("consent", "refuse", lambda s: [s.anna.handle, ["care"], []], {"anna"}),
    ("consent", "withdraw", lambda s: [s.anna.handle, [], []], {"anna"}),
    ("consent", "begin", lambda s: [s.anna.handle, ["care"]], set()),
    ("consent", "end", lambda s: [s.anna.handle], set()),
    ("records", "open_visit", _open, {"robot", "other-robot"}),
    ("records", "record", _record, {"robot"}),
    ("records", "close_visit", lambda s: [s.visit.owner, 2], {"robot"}),
    ("records", "begin_erasure", lambda s: [s.visit.owner, [s.record_id], []], set()),
    ("records", "complete_erasure", lambda s: [[s.record_id], []], set()),
    ("records", "expire", lambda s: [[s.record_id], bytes(33), 1], set()),
    ("access", "request", lambda s: [[s.record_id], "own-access"], {"owner"}),
    ("access", "released", lambda s: [s.access_id, [s.record_id]], {"custodian"}),
    ("access", "refused", lambda s: [s.access_id, "GONE"], {"custodian"}),
    ("access", "verdict", lambda s: [s.record_id, "verified", []], {"owner"}),
    ("erasure", "request", lambda s: [[s.record_id], []], {"owner"}),
    ("erasure", "request", lambda s: [[s.record_id], [1]], {"owner"}),
    ("erasure", "receipt", lambda s: [s.erasure_id, 1, "", 0, bytes(32)], {"custodian"}),
    ("erasure", "order", lambda s: [s.visit.owner, [s.record_id]], set()),
    ("consent", "objected", lambda s: [s.anna.handle, ["care"]], set()),
    ("rights", "restrict", lambda s: [[s.record_id], "accuracy"], {"owner"}),
    ("rights", "lift", lambda s: [[s.record_id]], {"owner"}),
    ("rights", "object_to", lambda s: [s.anna.handle, ["care"]], {"anna"}),
    ("rights", "object_to_release", lambda _: [["care"]], {"owner", "other-owner"}),
    ("rights", "rectify", lambda s: [[s.record_id], "attribution", bytes(32)], {"owner"}),
    ("rights", "wrong_person", lambda _: [], {"owner", "other-owner"}),
    ("rights", "assess", lambda s: [s.breach_id, "high", "released-before"], {"officer"}),
    ("rights", "notify", lambda s: [s.breach_id, "authority", ""], {"officer"}),
    ("rights", "order_erasure", lambda s: [s.breach_id, [s.denied_id]], {"officer"}),
    ("rights", "close", lambda s: [s.breach_id, "released", "owner-confirmed"], {"officer"}),
    ("audit", "append", lambda s: [s.visit.owner, b"", "recorded", {}], set()),
]


@pytest.mark.parametrize(("contract", "entry", "arguments", "allowed"), RULES)
def test_everyone_else_is_refused(
    hospital: Hospital, contract: str, entry: str, arguments: Arguments, allowed: set[str]
) -> None:
    scene = Scene(hospital)
    values = arguments(scene)
    for name, key in scene.everyone.items():
        if name in allowed:
            continue
        root = hospital.state.state_root
        receipt = hospital.send(key, contract, entry, *values)
        assert not receipt.ok, f"{name} may call {contract}.{entry}"
        assert receipt.code not in {"TYPE_ERROR", "KEY_ERROR", "VALUE_ERROR", "OUT_OF_GAS"}, name
        assert hospital.state.state_root == root


@pytest.mark.parametrize(("contract", "entry", "arguments", "allowed"), [rule for rule in RULES if rule[3]])
def test_those_who_may_call_can(contract: str, entry: str, arguments: Arguments, allowed: set[str]) -> None:
    for name in allowed:
        scene = Scene(Hospital())
        scene.hospital.must(scene.everyone[name], contract, entry, *arguments(scene))


def test_expiry_is_reported_by_custodians_only(hospital: Hospital) -> None:
    scene = Scene(hospital)
    hospital.time_ms += 400 * 24 * 3600 * 1000
    for name, key in scene.everyone.items():
        receipt = hospital.send(key, "erasure", "expired", [scene.record_id], bytes(32))
        assert receipt.ok == (name == "custodian"), name


def test_every_exported_entry_is_under_a_rule(hospital: Hospital) -> None:
    ruled = {(contract, entry) for contract, entry, _, _ in RULES}
    ruled |= {("identity", "register"), ("erasure", "expired")}
    exported = {
        (name, entry.name)
        for name, contract in hospital.contracts.items()
        for entry in contract.abi.entries
        if name in PRIVACY_CONTRACTS and entry.kind != "view"
    }
    assert exported == ruled
