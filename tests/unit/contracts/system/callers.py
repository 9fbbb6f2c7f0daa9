"""Every entry of the system contracts that changes something, with arguments, and everybody who might meddle.

`tests/security/test_authorisation_entries.py` tries each row of `RULES` with everybody of the scene.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from consensus.chain.genesis import prove_possession
from consensus.primitives.keys import PrivateKey
from contracts.lifecycle.registry import compute_source_hash
from tests.unit.contracts.privacy.hospital import Hospital, Person
from tests.unit.contracts.system.consortium import (
    CERTIFICATE,
    Consortium,
    admin_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)
from tests.unit.contracts.system.deploying import VISITORS, deploy, deployment, disabling, keeping, upload

ADMINS = {"admin-1", "admin-2", "admin-3"}
ROLE_OF = {
    "admin-1": "admin",
    "admin-2": "admin",
    "admin-3": "admin",
    "admin-removed": "former",
    "removed-producer": "former",
    "revoked": "former",
    "suspended": "candidate",
    "not-yet-candidate": "stranger",
} | {
    name: name
    for name in (
        "subject",
        "staff",
        "robot",
        "officer",
        "auditor",
        "registrar",
        "custodian",
        "producer",
        "candidate",
        "owner",
        "grantee",
        "stranger",
    )
}
SIGNERS = {"producer", "candidate", "suspended", "accused"}


class PeopledConsortium(Consortium, Hospital):
    """A consortium with people in it: blocks as the consortium makes them, members as the hospital enrols them."""

    def __init__(self, organisations: int, nodes: int) -> None:
        Consortium.__init__(self, organisations, nodes)
        self.registrar = key_of("org-01/registrar")
        self.robot = self.enrol("robot", "robot")


class Scene:
    """A candidate, a suspended producer, open proposals, and everybody who might meddle."""

    def __init__(self) -> None:
        self.chain = chain = PeopledConsortium(organisations=4, nodes=6)
        chain.agree("remove_org", {"name": "org-04"})
        chain.agree("add_node", node_fields("node-07", "org-01"))
        chain.agree("add_node", node_fields("node-08", "org-01"))
        first = admin_of("org-01")
        chain.must(first, "producers", "propose", producer_of("node-07").public_key)
        self.accused = producer_of("node-02")
        chain.must(producer_of("node-01"), "producers", "accuse", *chain.evidence(self.accused, round_number=1))
        self.proposal = chain.must(first, "membership", "propose", "add_org", organisation_fields("org-05")).txid
        self.setting = chain.must(first, "settings", "propose", "heartbeat_ms", 5000).txid
        deploy(chain, "doors", VISITORS)
        chain.block([])
        upload(chain, admin_of("org-01"), VISITORS)
        self.disabling = chain.must(first, "lifecycle", "propose", "disable", disabling("doors")).txid
        revoked = chain.enrol("revoked", "staff")
        chain.must(first, "identity", "revoke", revoked.handle)
        owner = chain.open_visit(chain.enrol("subject"))
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
            "subject": Person("subject").identity,
            "robot": chain.robot.identity,
            "revoked": revoked.identity,
            "owner": owner.key,
            "grantee": key_of("grantee"),
        }
        self.everyone |= {role: chain.enrol(role, role).identity for role in ("staff", "officer", "auditor")}


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
    ("lifecycle", "propose", lambda _: ["disable", disabling("doors")], ADMINS),
    ("lifecycle", "propose", _deploy, {"admin-1"}),
    ("lifecycle", "approve", lambda s: [s.disabling], ADMINS - {"admin-1"}),
    ("producers", "genesis", lambda _: [[], [], {}], set()),
    ("producers", "propose", lambda _: [_key("node-08")], ADMINS),
    ("producers", "approve", lambda _: [_key("node-07")], ADMINS - {"admin-1"}),
    ("producers", "withdraw", lambda _: [_key("node-03")], ADMINS),
    ("producers", "withdraw", lambda _: [_key("node-07")], {"admin-1"}),
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
