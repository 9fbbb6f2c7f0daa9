"""Every entry of the privacy contracts that changes something, with arguments, and everybody who might meddle.

`tests/security/test_authorisation_entries.py` tries each row of `RULES` with everybody of the scene.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from consensus.primitives.keys import PrivateKey
from contracts.execution.callers import MEMBERS, NOT_YET_MEMBERS, RECORDED
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit, key_of
from tests.unit.contracts.system.consortium import node_fields, producer_of

ROLE_OF = {
    "anna": "subject",
    "ben": "subject",
    "owner": "owner",
    "other-owner": "owner",
    "denied-owner": "owner",
    "new-owner": "owner",
    "replaced-owner": "stranger",
    "robot": "robot",
    "other-robot": "robot",
    "revoked": "former",
    "officer-2": "officer",
    "officer-3": "officer",
    "child": "subject",
    "grantee": "grantee",
} | {
    name: name
    for name in ("staff", "officer", "auditor", "registrar", "admin", "custodian", "producer", "candidate", "stranger")
}
DAY_MS = 24 * 3600 * 1000
BUCKET_MS = 300_000
OFFICERS = {"officer", "officer-2", "officer-3"}
LATER_MS = {("erasure", "expired"): 400 * DAY_MS, ("mandates", "close"): 400 * DAY_MS}
"""How much later an entry is called than the rest."""


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
        self.transferred = hospital.open_visit(self.ben, 2)
        self.new_owner = hospital.transfer(self.transferred, self.ben)
        self.breach_id = hospital.must(self.denied.key, "rights", "wrong_person").txid
        self.people = {
            "anna": self.anna,
            "ben": self.ben,
            "robot": hospital.robot,
            "staff": hospital.enrol("staff", "staff"),
            "officer": hospital.enrol("officer", "officer"),
            "officer-2": hospital.enrol("officer-2", "officer"),
            "officer-3": hospital.enrol("officer-3", "officer"),
            "child": hospital.enrol("child"),
            "auditor": hospital.enrol("auditor", "auditor"),
        }
        officer = self.people["officer"].identity
        revoked = hospital.enrol("revoked", "robot")
        hospital.must(hospital.admin, "identity", "revoke", revoked.handle)
        hospital.must(hospital.admin, "membership", "propose", "add_node", node_fields("node-09", "ward"))
        hospital.must(hospital.admin, "producers", "propose", producer_of("node-09").public_key)
        hospital.must(officer, "rights", "assess", self.breach_id, "none", "matched-wrongly")
        hospital.must(self.visit.key, "rights", "restrict", [self.record_id], "accuracy")
        self._propose(officer)
        self._give_mandates()
        self.robot, self.frame = hospital.robot.identity.public_key, b"\x01" * 32
        hospital.must(officer, "records", "approve_empty_frames", self.robot, [self.frame])
        self.grantee = key_of("grantee")
        self.grant_id = hospital.must(self.others_visit.key, "access", "grant", *self.grant_of(self.grantee)).txid
        self.everyone: dict[str, PrivateKey] = {
            "anna": self.anna.identity,
            "ben": self.ben.identity,
            "owner": self.visit.key,
            "other-owner": self.others_visit.key,
            "robot": hospital.robot.identity,
            "other-robot": self.other_robot.identity,
            "staff": self.people["staff"].identity,
            "officer": officer,
            "officer-2": self.people["officer-2"].identity,
            "officer-3": self.people["officer-3"].identity,
            "child": self.people["child"].identity,
            "denied-owner": self.denied.key,
            "new-owner": self.new_owner,
            "replaced-owner": self.transferred.key,
            "auditor": self.people["auditor"].identity,
            "revoked": revoked.identity,
            "producer": key_of("custodian-1/producer"),
            "candidate": producer_of("node-09"),
            "registrar": hospital.registrar,
            "admin": hospital.admin,
            "custodian": hospital.custodians[0],
            "grantee": self.grantee,
            "stranger": key_of("stranger"),
        }

    def grant_of(self, grantee: PrivateKey) -> list[Any]:
        """Return the arguments that share the other visit's record with a key."""
        until_ms = self.others_visit.bucket_ms + DAY_MS
        return [[self.others_id], grantee.public_key, key_of("ephemeral").public_key, 7, bytes(32), "care", until_ms]

    def mandate_of(self, person: Person, representative: str) -> list[Any]:
        """Return the arguments that propose a mandate."""
        until_ms = self.hospital.bucket() + 30 * DAY_MS
        return [person.handle, self.people[representative].handle, bytes(32), ["consent"], until_ms]

    def _give_mandates(self) -> None:
        """Mandates at each step: proposed and approved ones for people who say nothing else, and two in force."""
        hospital, (first, second) = self.hospital, (self.people[name].identity for name in ("officer", "officer-2"))
        self.mandates: dict[str, bytes] = {}
        for name in ("proposed", "anna", "staff", "officer-3", "active-staff", "active"):
            person = self.people["child"] if name == "active" else hospital.enrol(f"young-{name}")
            representative = {"proposed": "anna", "active-staff": "staff", "active": "officer-3"}.get(name, name)
            mandate_id = hospital.must(first, "mandates", "propose", *self.mandate_of(person, representative)).txid
            self.mandates[name] = mandate_id
            if name != "proposed":
                hospital.must(second, "mandates", "approve", mandate_id)
            if name.startswith("active"):
                hospital.must(self.people[representative].identity, "mandates", "accept", mandate_id)

    def _propose(self, officer: PrivateKey) -> None:
        """One officer proposes twice what two of them erase together; another approves one of the proposals."""
        hospital = self.hospital
        self.others_id = hospital.record(self.others_visit)
        bucket_ms = self.others_visit.bucket_ms
        self.span = [self.others_visit.robot.identity.public_key, bucket_ms, bucket_ms + BUCKET_MS]
        hospital.time_ms = bucket_ms + BUCKET_MS
        arguments = [*self.span, "key-lost", 1]
        self.proposal_id = hospital.must(officer, "officers", "propose", *arguments).txid
        self.approved_id = hospital.must(officer, "officers", "propose", *arguments).txid
        hospital.must(self.people["officer-2"].identity, "officers", "approve", self.approved_id)


class _Newcomer(Person):
    """Somebody with a card, under a key that may have another role already."""

    def __init__(self, key: PrivateKey) -> None:
        super().__init__("newcomer")
        self.key = key

    @property
    def identity(self) -> PrivateKey:
        return self.key


def _registration(scene: Scene, name: str) -> list[Any]:
    hospital = scene.hospital
    return hospital.register_arguments(_Newcomer(scene.everyone[name]), hospital.card("newcomer"))


def _rotation(scene: Scene, name: str) -> list[Any]:
    return scene.hospital.rotation_arguments(scene.people[name], Person("new"))


def _open(scene: Scene) -> list[Any]:
    return scene.hospital.visit_of(scene.ben, 9)[1]


def _transfer(scene: Scene) -> list[Any]:
    return scene.hospital.transfer_arguments(scene.visit.owner, scene.ben, 98)[1]


def _record(scene: Scene) -> list[Any]:
    return scene.hospital.record_arguments(scene.visit, 9)


Arguments = Callable[[Scene], list[Any]]
RULES: list[tuple[str, str, Arguments, set[str]]] = [
    ("identity", "revoke", lambda s: [s.anna.handle], {"registrar", "admin"}),
    ("identity", "name_robot", lambda s: [s.hospital.robot.handle, "Robbie", "Ward 4"], {"registrar", "admin"}),
    ("identity", "genesis", lambda _: [[], [], []], set()),
    ("identity", "put_organisation", lambda _: ["ward", [bytes(33)], []], set()),
    ("identity", "remove_organisation", lambda _: ["ward"], set()),
    ("identity", "add_custodian", lambda _: [bytes(33), "node", "ward"], set()),
    ("identity", "remove_custodians", lambda _: [[]], set()),
    ("identity", "declare_room", lambda _: [4_000], {"custodian"}),
    ("consent", "begin", lambda s: [s.anna.handle, ["care"]], set()),
    ("consent", "end", lambda s: [s.anna.handle], set()),
    ("consent", "end_mandate", lambda s: [s.people["child"].handle, s.mandates["active"]], set()),
    ("consent", "publish_notice", lambda _: [b"words"], {"admin"}),
    ("records", "open_visit", _open, {"robot", "other-robot"}),
    ("records", "record", _record, {"robot"}),
    ("records", "close_visit", lambda s: [s.visit.owner, 2], {"robot"}),
    ("records", "transfer", _transfer, {"owner"}),
    ("records", "begin_erasure", lambda s: [s.visit.owner, [s.record_id], []], set()),
    ("records", "complete_erasure", lambda s: [[s.record_id], []], set()),
    ("records", "expire", lambda s: [[s.record_id], bytes(33), [bytes(33)]], set()),
    ("records", "approve_empty_frames", lambda s: [s.robot, [bytes(32)]], {*OFFICERS, "admin"}),
    ("records", "withdraw_empty_frames", lambda s: [s.robot, [s.frame]], {*OFFICERS, "admin"}),
    ("access", "request", lambda s: [[s.record_id], "own-access"], {"owner"}),
    ("access", "released", lambda s: [s.access_id, [s.record_id]], {"custodian"}),
    ("access", "refused", lambda s: [s.access_id, "GONE"], {"custodian"}),
    ("access", "grant", lambda s: s.grant_of(key_of("fresh")), {"other-owner"}),
    ("access", "revoke", lambda s: [s.grant_id], {"other-owner"}),
    ("access", "request_granted", lambda s: [s.grant_id, [s.others_id], "care"], {"grantee"}),
    ("access", "noticed", lambda s: [s.grant_id, [s.others_id]], {"grantee"}),
    ("access", "verdict", lambda s: [[[s.record_id, "verified", []]]], {"owner"}),
    ("erasure", "request", lambda s: [[s.record_id], []], {"owner"}),
    ("erasure", "request", lambda s: [[s.record_id], [1]], {"owner"}),
    ("erasure", "receipt", lambda s: [s.erasure_id, 1, "", 0, bytes(32)], {"custodian"}),
    ("erasure", "expired", lambda s: [[s.record_id], bytes(32)], {"custodian"}),
    ("erasure", "order", lambda s: [s.visit.owner, [s.record_id]], set()),
    ("consent", "objected", lambda s: [s.anna.handle, ["care"]], set()),
    ("rights", "restrict", lambda s: [[s.record_id], "accuracy"], {"owner"}),
    ("rights", "lift", lambda s: [[s.record_id]], {"owner"}),
    ("rights", "object_to_release", lambda _: [["care"]], {"owner", "other-owner", "new-owner"}),
    ("rights", "rectify", lambda s: [[s.record_id], "attribution", bytes(32)], {"owner"}),
    ("rights", "wrong_person", lambda _: [], {"owner", "other-owner", "new-owner"}),
    ("rights", "assess", lambda s: [s.breach_id, "high", "released-before"], OFFICERS),
    ("rights", "notify", lambda s: [s.breach_id, "authority", ""], OFFICERS),
    ("rights", "order_erasure", lambda s: [s.breach_id, [s.denied_id]], OFFICERS),
    ("rights", "close", lambda s: [s.breach_id, "released", "owner-confirmed"], OFFICERS),
    ("officers", "propose", lambda s: [*s.span, "key-lost", 1], OFFICERS),
    ("officers", "approve", lambda s: [s.proposal_id], {"officer-2", "officer-3"}),
    ("officers", "erase", lambda s: [s.approved_id, s.others_visit.owner, [s.others_id]], {"officer", "officer-2"}),
    ("officers", "stop", lambda s: [s.approved_id], OFFICERS),
    ("mandates", "propose", lambda s: s.mandate_of(s.anna, "ben"), OFFICERS),
    ("mandates", "approve", lambda s: [s.mandates["proposed"]], {"officer-2", "officer-3"}),
    ("mandates", "accept", lambda s: [s.mandates["anna"]], {"anna"}),
    ("mandates", "accept", lambda s: [s.mandates["staff"]], {"staff"}),
    ("mandates", "accept", lambda s: [s.mandates["officer-3"]], {"officer-3"}),
    ("mandates", "end", lambda s: [s.mandates["active"]], {"child", *OFFICERS}),
    ("mandates", "end", lambda s: [s.mandates["active-staff"]], {"staff", *OFFICERS}),
    ("mandates", "close", lambda s: [s.mandates["active"]], {name for name in ROLE_OF if ROLE_OF[name] in MEMBERS}),
    ("mandates", "note", lambda s: [s.mandates["active"], "given", {}], set()),
    ("audit", "append", lambda s: [s.visit.owner, b"", "recorded", {}], set()),
]


def _of_members() -> list[tuple[str, str, Arguments, set[str]]]:
    """What a member does under a handle, once for each who has one."""
    rows: list[tuple[str, str, Arguments, set[str]]] = []
    for name in sorted(name for name in ROLE_OF if ROLE_OF[name] in MEMBERS and name != "other-robot"):
        handle: Callable[[Scene], bytes] = lambda s, n=name: s.people[n].handle  # noqa: E731
        rows += [
            ("identity", "authenticate", lambda s, h=handle: [h(s)], {name}),
            ("identity", "rotate", lambda s, n=name: _rotation(s, n), {name}),
            ("identity", "leave", lambda s, h=handle: [h(s)], {name}),
        ]
        recorded = {name} if ROLE_OF[name] in RECORDED else set()
        rows.append(("consent", "give", lambda s, h=handle: [h(s), ["care"], ["rgb"], 0, 0, 0, 0], recorded))
        if name == "child":
            recorded = {name, "officer-3"}
        rows += [
            (
                "consent",
                "give",
                lambda s, h=handle: [h(s), ["care"], ["rgb"], 0, s.hospital.bucket() + DAY_MS, 0, s.hospital.height],
                recorded,
            ),
            ("consent", "refuse", lambda s, h=handle: [h(s), ["care"], []], recorded),
            ("consent", "withdraw", lambda s, h=handle: [h(s), [], []], recorded),
            ("rights", "object_to", lambda s, h=handle: [h(s), ["care"]], recorded),
        ]
    return rows


RULES += _of_members()
RULES += [
    (
        "identity",
        "register",
        lambda s, n=name: _registration(s, n),
        {name} if ROLE_OF[name] in NOT_YET_MEMBERS else set(),
    )
    for name in ROLE_OF
]
