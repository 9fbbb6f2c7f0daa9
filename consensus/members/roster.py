"""A robot's roster of the day: tag -> handle and keys, signed, sealed to the robot.

A row is found by HMAC(roster key, UID), so the file alone gives no tag away, and a robot never asks a node about one
person. Each row can carry a proof of the member's state on the chain, so a dishonest registrar cannot slip in keys
of his own unnoticed.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Collection
from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, decode_value, encode
from consensus.primitives.keys import PrivateKey, is_public_key, recover
from consensus.primitives.trie import Proof, verify_proof
from consensus.records.envelopes import open_sealed, seal_to
from consensus.state.identity import MEMBER

ROSTER_VERSION = 2
ROSTER_TAG = "blockrobot/roster"
ROSTER_LIFETIME_MAX_MS = 24 * 3600 * 1000
ROSTER_CLOCK_TOLERANCE_MS = 5 * 60 * 1000
ROSTER_ROWS_MAX_COUNT = 10_000
ROSTER_KEY_BYTES = 32


class RosterRow(Wire, frozen=True):
    """One person: `tag` = HMAC of the card's UID (32), handle 32, S and V 33, X 32.

    `proof` is an encoded `RowProof`, or empty. What the person consents to is asked of the chain, never of a roster.
    """

    tag: bytes
    handle: bytes
    spend: bytes
    view: bytes
    sealing: bytes
    proof: bytes


class RowProof(Wire, frozen=True):
    """What shows a row to be the chain's: the member key, its encoded state and the pages that lead to it."""

    member: bytes
    value: bytes
    proof: Proof


class Roster(Wire, frozen=True):
    """The roster of one robot (its member key, 33 bytes), with the HMAC key of its rows. Times in ms."""

    version: int
    chain_id: bytes
    robot: bytes
    key: bytes
    issued_at_ms: int
    not_after_ms: int
    rows: tuple[RosterRow, ...]


class SignedRoster(Wire, frozen=True):
    """The roster's bytes and the registrar's 65-byte recoverable signature over them."""

    roster: bytes
    signature: bytes


def roster_tag(key: bytes, uid: str) -> bytes:
    """Return HMAC-SHA256(roster key, UID), 32 bytes. Case and surrounding space of the UID do not matter."""
    return hmac.new(key, uid.strip().upper().encode(), hashlib.sha256).digest()


def seal_roster(roster: Roster, registrar: PrivateKey, robot_sealing: bytes) -> bytes:
    """Sign the roster and seal it to the robot's X25519 key. Raises ROSTER_INVALID for one outside its limits."""
    _check_form(roster)
    data = encode(roster)
    return seal_to(robot_sealing, encode(SignedRoster(roster=data, signature=registrar.sign(ROSTER_TAG, data))))


def _check_form(roster: Roster) -> None:
    lifetime_ms = roster.not_after_ms - roster.issued_at_ms
    if (
        roster.version != ROSTER_VERSION
        or len(roster.chain_id) != 32
        or len(roster.robot) != 33
        or len(roster.key) != ROSTER_KEY_BYTES
        or not 0 < lifetime_ms <= ROSTER_LIFETIME_MAX_MS
        or len(roster.rows) > ROSTER_ROWS_MAX_COUNT
        or any(_is_bad_row(row) for row in roster.rows)
        or len({row.tag for row in roster.rows}) != len(roster.rows)
    ):
        raise BlockRobotError("ROSTER_INVALID", "The roster or a row of it is outside its limits.")


def _is_bad_row(row: RosterRow) -> bool:
    sizes = (len(row.tag), len(row.handle), len(row.spend), len(row.view), len(row.sealing))
    return sizes != (32, 32, 33, 33, 32)


def is_usable(row: RosterRow) -> bool:
    """Tell whether something can be recorded for this person: the keys are points, and X one that can be sealed to.

    The chain takes keys by their size. Somebody with others must not end a run: nobody is known by such a row.
    """
    try:
        seal_to(row.sealing, b"")
    except BlockRobotError:
        return False
    return is_public_key(row.spend) and is_public_key(row.view)


def open_roster(
    sealed: bytes,
    sealing_private: bytes,
    *,
    registrars: Collection[bytes],
    now_ms: int,
    robot: bytes | None = None,
    chain_id: bytes | None = None,
) -> Roster:
    """Open a sealed roster with the robot's X25519 private key and check signer, form and age.

    `registrars` are the 33-byte keys that may sign. `robot` and `chain_id`, if given, must be those of the roster.
    Raises ROSTER_INVALID, or ROSTER_EXPIRED for one that is out of date or not yet valid.
    """
    try:
        signed = decode(open_sealed(sealing_private, sealed), SignedRoster)
        signer = recover(ROSTER_TAG, signed.signature, signed.roster)
        roster = decode(signed.roster, Roster)
    except BlockRobotError:
        raise BlockRobotError("ROSTER_INVALID") from None
    if signer not in registrars:
        raise BlockRobotError("ROSTER_INVALID", "The roster is not signed by a registrar of this network.")
    _check_form(roster)
    if robot is not None and roster.robot != robot:
        raise BlockRobotError("ROSTER_INVALID", "The roster is for another robot.")
    if chain_id is not None and roster.chain_id != chain_id:
        raise BlockRobotError("ROSTER_INVALID", "The roster is of another network.")
    if not roster.issued_at_ms - ROSTER_CLOCK_TOLERANCE_MS <= now_ms < roster.not_after_ms:
        raise BlockRobotError("ROSTER_EXPIRED")
    return roster


def verify_row(row: RosterRow, state_root: bytes) -> bytes:
    """Check a row against a state root (32 bytes) and return the member key that it belongs to.

    Raises ROSTER_INVALID if the row has no proof, the proof fails, or the chain says otherwise than the row.
    """
    try:
        shown = decode(row.proof, RowProof)
        verify_proof(state_root, MEMBER.key(shown.member), shown.value, shown.proof)
        member: Any = decode_value(shown.value)
    except BlockRobotError:
        raise BlockRobotError("ROSTER_INVALID", "A row's proof does not lead to the state root.") from None
    told = (row.handle, row.spend, row.view, row.sealing, "active")
    if told != tuple(member.get(name) for name in ("handle", "spend", "view", "sealing", "status")):
        raise BlockRobotError("ROSTER_INVALID", "The chain says otherwise of a member than the roster.")
    return shown.member
