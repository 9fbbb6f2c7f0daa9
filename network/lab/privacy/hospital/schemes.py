"""The ways of naming an owner that are compared: the paper's prototype, its proposals, and ours.

The prototype writes SHA-256 of the tag's UID on each record and in its list of users. Salted: a salt for each record,
public beside it. Peppered: one secret in every hash, not on the chain. Ours puts no function of a UID anywhere.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

PROTOTYPE = "prototype"
SALTED = "salted"
PEPPERED = "peppered"
PEPPER_STOLEN = "pepper_stolen"
OURS = "ours"
PAPER_SCHEMES = (PROTOTYPE, SALTED, PEPPERED, PEPPER_STOLEN)
SCHEMES = (*PAPER_SCHEMES, OURS)
_SALT_BYTES = 16
_PEPPER_BYTES = 32


@dataclass(frozen=True, slots=True)
class OwnerMark:
    """What a scheme writes of an owner: the hash, and the public salt that goes with it (or none)."""

    salt: bytes
    digest: bytes


@dataclass(frozen=True, slots=True)
class Scheme:
    """One scheme with its secret. `known_pepper` is what an attacker has of it."""

    name: str
    pepper: bytes = b""
    known_pepper: bytes | None = b""

    def mark(self, uid: str) -> OwnerMark:
        """Return what is written on one record, or for one user, of a tag's bearer."""
        salt = secrets.token_bytes(_SALT_BYTES) if self.name == SALTED else b""
        return OwnerMark(salt, hash_uid(self.pepper, salt, uid.encode()))

    def mark_of(self, uid: bytes, salt: bytes) -> bytes:
        """Return what is written of a UID under a salt."""
        return hash_uid(self.pepper, salt, uid)

    def marks(self, uids: Sequence[str]) -> list[OwnerMark]:
        """Return a mark for each UID."""
        return [self.mark(uid) for uid in uids]


def hash_uid(pepper: bytes, salt: bytes, uid: bytes) -> bytes:
    """Return SHA-256 of pepper, salt and UID; without both it is the prototype's."""
    return hashlib.sha256(pepper + salt + uid).digest()


def make_schemes() -> dict[str, Scheme]:
    """Return the four of the paper; the pepper of two of them is the same, once unknown and once stolen."""
    pepper = secrets.token_bytes(_PEPPER_BYTES)
    return {
        PROTOTYPE: Scheme(PROTOTYPE),
        SALTED: Scheme(SALTED),
        PEPPERED: Scheme(PEPPERED, pepper, None),
        PEPPER_STOLEN: Scheme(PEPPER_STOLEN, pepper, pepper),
    }
