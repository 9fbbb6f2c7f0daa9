"""Every entry of the system contracts, tried by everyone who may not call it: nothing but a receipt remains."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from consensus.possession import prove_possession
from consensus.primitives.keys import PrivateKey
from contracts.execution.registry import SYSTEM_CONTRACTS, compute_source_hash
from tests.unit.contracts.system.consortium import (
    CERTIFICATE,
    Consortium,
    admin_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)
from tests.unit.contracts.system.deploying import VISITORS, deployment, disabling, keeping, upload

ADMINS = {"admin-1", "admin-2", "admin-3"}
SIGNERS = {"producer", "candidate", "suspended", "accused"}


class Scene:
    """A candidate, a suspended producer, open proposals, and everybody who might meddle."""

    def __init__(self) -> None:
        self.chain = chain = Consortium(organisations=4, nodes=6)
        chain.agree("remove_org", {"name": "org-04"})
        chain.agree("add_node", node_fields("node-07", "org-01"))
        chain.agree("add_node", node_fields("node-08", "org-01"))
        first = admin_of("org-01")
        chain.must(first, "producers", "propose", producer_of("node-07").public_key)
        self.accused = producer_of("node-02")
        chain.must(producer_of("node-01"), "producers", "accuse", *chain.evidence(self.accused, round_number=1))
        self.proposal = chain.must(first, "membership", "propose", "add_org", organisation_fields("org-05")).txid
        self.setting = chain.must(first, "settings", "propose", "heartbeat_ms", 5000).txid
        upload(chain, admin_of("org-01"), VISITORS)
        self.disabling = chain.must(first, "lifecycle", "propose", "disable", disabling("audit")).txid
        self.everyone: dict[str, PrivateKey] = {
            "admin-1": first,
            "admin-2": admin_of("org-02"),
            "admin-3": admin_of("org-03"),
            "admin-removed": admin_of("org-04"),
            "registrar": key_of("org-01/registrar"),
            "custodian": key_of("node-01/custodian"),
            "producer": producer_of("node-01"),
            "candidate": producer_of("node-07"),
            "not-yet-candidate": producer_of("node-08"),
            "suspended": self.accused,
            "removed-producer": producer_of("node-04"),
            "stranger": key_of("stranger"),
        }


def _key(name: str) -> bytes:
    return producer_of(name).public_key


def _evidence(scene: Scene) -> list[Any]:
    return scene.chain.evidence(producer_of("node-03"))


def _rekey(_: Scene) -> list[Any]:
    key = key_of("new")
    fields = {
        "node": "node-03",
        "producer_key": key.public_key,
        "producer_possession": prove_possession(key, "node-03"),
    }
    return ["rekey_producer", fields]


def _deploy(_: Scene) -> list[Any]:
    return ["deploy", deployment("visitors", VISITORS)]


Arguments = Callable[[Scene], list[Any]]
RULES: list[tuple[str, str, Arguments, set[str]]] = [
    ("membership", "genesis", lambda _: [[], []], set()),
    ("membership", "propose", lambda _: ["add_org", organisation_fields("org-06")], ADMINS),
    ("membership", "propose", lambda _: ["remove_org", {"name": "org-03"}], ADMINS),
    (
        "membership",
        "propose",
        lambda _: ["replace_ca", {"organisation": "org-02", "ca_certificate": CERTIFICATE}],
        ADMINS,
    ),
    (
        "membership",
        "propose",
        lambda _: [
            "replace_keys",
            {"organisation": "org-02", "admins": [key_of("newcomer").public_key], "registrars": []},
        ],
        ADMINS,
    ),
    ("membership", "propose", lambda _: ["add_node", node_fields("node-09", "org-02")], ADMINS),
    ("membership", "propose", lambda _: ["remove_node", {"name": "node-03"}], ADMINS),
    ("membership", "propose", _rekey, ADMINS),
    (
        "membership",
        "propose",
        lambda _: ["revoke_certificate", {"organisation": "org-02", "serial": bytes(20)}],
        ADMINS,
    ),
    ("membership", "approve", lambda s: [s.proposal], ADMINS - {"admin-1"}),
    ("membership", "withdraw", lambda s: [s.proposal], {"admin-1"}),
    ("membership", "propose_setting", lambda _: ["heartbeat_ms", 1], set()),
    ("membership", "approve_setting", lambda s: [s.setting], set()),
    ("membership", "propose_contract", lambda _: ["keep", keeping("settings")], set()),
    ("membership", "approve_contract", lambda s: [s.disabling], set()),
    ("lifecycle", "genesis", lambda _: [[]], set()),
    ("lifecycle", "upload", lambda _: [bytes(32), 2, 0, b"data"], ADMINS),
    ("lifecycle", "check_upload", lambda _: [compute_source_hash(VISITORS)], {"admin-1"}),
    ("lifecycle", "propose", lambda _: ["disable", disabling("audit")], ADMINS),
    ("lifecycle", "propose", _deploy, {"admin-1"}),
    ("lifecycle", "approve", lambda s: [s.disabling], ADMINS - {"admin-1"}),
    ("producers", "genesis", lambda _: [[], [], {}], set()),
    ("producers", "propose", lambda _: [_key("node-08")], ADMINS),
    ("producers", "approve", lambda _: [_key("node-07")], ADMINS - {"admin-1"}),
    ("producers", "withdraw", lambda _: [_key("node-03")], ADMINS),
    ("producers", "remove", lambda _: [_key("node-03")], ADMINS),
    ("producers", "ready", lambda s: [s.chain.height, bytes(32)], {"candidate", "suspended"}),
    ("producers", "accuse", _evidence, SIGNERS - {"accused"}),
    ("producers", "rekey", lambda _: [_key("node-03"), bytes(33)], set()),
    ("producers", "remove_keys", lambda _: [[_key("node-03")], ["org-01"], "org-03"], set()),
    ("producers", "forget_voice", lambda _: ["org-03"], set()),
    ("producers", "change_setting", lambda _: ["heartbeat_ms", 1], set()),
    ("settings", "propose", lambda _: ["blocks_per_turn", 2], ADMINS),
    ("settings", "approve", lambda s: [s.setting], ADMINS - {"admin-1"}),
]


@pytest.mark.parametrize(("contract", "entry", "arguments", "allowed"), RULES)
def test_everyone_else_is_refused(contract: str, entry: str, arguments: Arguments, allowed: set[str]) -> None:
    scene = Scene()
    values = arguments(scene)
    for name, key in scene.everyone.items():
        if name in allowed:
            continue
        root = scene.chain.state.state_root
        receipt = scene.chain.send(key, contract, entry, *values)
        assert not receipt.ok, f"{name} may call {contract}.{entry}"
        assert receipt.code not in {"TYPE_ERROR", "KEY_ERROR", "VALUE_ERROR", "OUT_OF_GAS", "NAME_UNSET"}, name
        assert scene.chain.state.state_root == root


@pytest.mark.parametrize(("contract", "entry", "arguments", "allowed"), [rule for rule in RULES if rule[3]])
def test_those_who_may_call_can(contract: str, entry: str, arguments: Arguments, allowed: set[str]) -> None:
    for name in allowed:
        scene = Scene()
        scene.chain.must(scene.everyone[name], contract, entry, *arguments(scene))


def test_every_exported_entry_is_under_a_rule() -> None:
    contracts = Consortium().contracts
    exported = {
        (name, entry.name) for name in SYSTEM_CONTRACTS for entry in contracts[name].abi.entries if entry.kind != "view"
    }
    assert exported == {(contract, entry) for contract, entry, _, _ in RULES}
