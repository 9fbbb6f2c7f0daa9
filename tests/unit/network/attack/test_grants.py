"""Whom was it shared with? Grants of real contracts under attack, and careless ones, which the same attack names."""

from __future__ import annotations

import secrets
from typing import Any

from consensus.primitives.encoding import u64
from consensus.primitives.hashing import sha256
from consensus.records.sharing import GRANT_STEP_MS, hash_grant_member, open_grant_keys
from consensus.state.access import GRANT
from network.lab.privacy.attacks.grants import link_grants, name_grantees, read_grants
from network.lab.privacy.attacks.naming import PublicKeys
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person


class Ward:
    """Three nurses, and a visit whose record is shared with them."""

    def __init__(self) -> None:
        self.hospital = Hospital()
        self.nurses = [self.hospital.enrol(f"nurse-{number}", "staff") for number in range(3)]
        self.visit = self.hospital.open_visit(self.hospital.enrol("anna"))
        self.hospital.record(self.visit)
        end = self.hospital.time_ms + DAY_MS
        self.until_ms = end - end % GRANT_STEP_MS

    def share(self, nurse: Person, *, secret: bytes, salt: bytes) -> bytes:
        where: dict[str, Any] = {"chain_id": self.hospital.chain_id, "owner": self.visit.owner}
        made = open_grant_keys(secret, nurse.view.public_key, nurse.spend.public_key, **where)
        words = [self.visit.records, made.owner, made.ephemeral, made.view_tag, hash_grant_member(salt, nurse.handle)]
        return self.hospital.must(self.visit.key, "access", "grant", *words, "care", self.until_ms).txid

    def attack(self) -> tuple[dict[bytes, int], set[frozenset[bytes]]]:
        grants = read_grants(dict(self.hospital.state.scan(GRANT.flat, 100)))
        people: list[PublicKeys] = [
            (nurse.identity.public_key, nurse.spend.public_key, nurse.view.public_key) for nurse in self.nurses
        ]
        handles = [nurse.handle for nurse in self.nurses]
        return name_grantees(grants, people, handles, self.hospital.chain_id), link_grants(grants)


def test_nobody_is_named_nor_grants_joined_unless_a_salt_is_public_or_used_again() -> None:
    ward = Ward()
    for _ in range(2):
        for nurse in ward.nurses:
            ward.share(nurse, secret=secrets.token_bytes(32), salt=secrets.token_bytes(32))
    assert ward.attack() == ({}, set())
    named = ward.share(ward.nurses[2], secret=secrets.token_bytes(32), salt=sha256(ward.visit.records[0]))
    kept = secrets.token_bytes(32)
    pair = frozenset(ward.share(ward.nurses[0], secret=secrets.token_bytes(32), salt=kept) for _ in range(2))
    assert ward.attack() == ({named: 2}, {pair})


def test_a_wallet_that_drew_its_secret_from_what_is_public_would_be_seen_through() -> None:
    ward = Ward()
    careless = sha256(ward.visit.owner + u64(ward.until_ms))
    grant_id = ward.share(ward.nurses[1], secret=careless, salt=secrets.token_bytes(32))
    assert ward.attack() == ({grant_id: 1}, set())
