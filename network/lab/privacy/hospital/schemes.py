"""Owner-naming schemes compared: the paper's prototype, its proposals, and ours.

Prototype: SHA-256 of UID on records and user list. Salted: a public salt per record. Peppered: one off-chain secret.
Ours: no function of a UID.
"""

from __future__ import annotations

import hashlib
import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from consensus.errors import BlockRobotError
from consensus.records.renditions import decode_rendition

PROTOTYPE = "prototype"
SALTED = "salted"
PEPPERED = "peppered"
PEPPER_STOLEN = "pepper_stolen"
OURS = "ours"
PAPER_SCHEMES = (PROTOTYPE, SALTED, PEPPERED, PEPPER_STOLEN)
SCHEMES = (*PAPER_SCHEMES, OURS)
_SALT_BYTES = 16
_PEPPER_BYTES = 32
STORE_FILE_NAME = "pictures.sqlite3"


@dataclass(frozen=True, slots=True)
class OwnerMark:
    """A scheme's owner mark: hash and public salt, if any."""

    salt: bytes
    digest: bytes


@dataclass(frozen=True, slots=True)
class Scheme:
    """A scheme with its secret. `known_pepper`: the attacker's knowledge of it."""

    name: str
    pepper: bytes = b""
    known_pepper: bytes | None = b""

    def mark(self, uid: str) -> OwnerMark:
        salt = secrets.token_bytes(_SALT_BYTES) if self.name == SALTED else b""
        return OwnerMark(salt, hash_uid(self.pepper, salt, uid.encode()))

    def marks(self, uids: Sequence[str]) -> list[OwnerMark]:
        return [self.mark(uid) for uid in uids]


def hash_uid(pepper: bytes, salt: bytes, uid: bytes) -> bytes:
    """Return SHA-256 of pepper, salt, UID; the prototype's if both are empty."""
    return hashlib.sha256(pepper + salt + uid).digest()


def make_schemes() -> dict[str, Scheme]:
    pepper = secrets.token_bytes(_PEPPER_BYTES)
    return {
        PROTOTYPE: Scheme(PROTOTYPE),
        SALTED: Scheme(SALTED),
        PEPPERED: Scheme(PEPPERED, pepper, None),
        PEPPER_STOLEN: Scheme(PEPPER_STOLEN, pepper, pepper),
    }


def write_plain_store(folder: Path, pictures: Iterable[tuple[bytes, bytes]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(folder / STORE_FILE_NAME)) as database, database:
        database.execute("CREATE TABLE images (mark BLOB NOT NULL, image BLOB NOT NULL)")
        database.executemany("INSERT INTO images VALUES (?, ?)", list(pictures))


def open_plain_store(folder: Path) -> tuple[int, int]:
    with closing(sqlite3.connect(folder / STORE_FILE_NAME)) as database:
        images = [row[0] for row in database.execute("SELECT image FROM images")]
    return len(images), sum(map(_shows, images))


def _shows(image: bytes) -> bool:
    try:
        return bool(decode_rendition(image).pixels)
    except BlockRobotError:
        return False
