"""A robot's signed, sealed daily roster; rows are found by HMAC(roster key, UID), and proofs expose forged keys."""

from __future__ import annotations

import hashlib
import hmac
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
    """One person: `tag` = HMAC of card UID (32 bytes), handle 32, S and V 33, X 32.

    `proof` is an encoded `RowProof` or empty; consent is read from the chain.
    """

    tag: bytes
    handle: bytes
    spend: bytes
    view: bytes
    sealing: bytes
    proof: bytes


class RowProof(Wire, frozen=True):
    """A row's proof: member key, encoded state and trie pages."""

    member: bytes
    value: bytes
    proof: Proof


class Roster(Wire, frozen=True):
    """One robot's roster (member key, 33 bytes) and row HMAC key; times in ms."""

    version: int
    chain_id: bytes
    robot: bytes
    key: bytes
    issued_at_ms: int
    not_after_ms: int
    rows: tuple[RosterRow, ...]


class SignedRoster(Wire, frozen=True):
    """Roster bytes and the registrar's 65-byte recoverable signature."""

    roster: bytes
    signature: bytes


def roster_tag(key: bytes, uid: str) -> bytes:
    """Return HMAC-SHA256(roster key, UID), 32 bytes; UID case and outer space are ignored."""
    return hmac.new(key, uid.strip().upper().encode(), hashlib.sha256).digest()


def seal_roster(roster: Roster, registrar: PrivateKey, robot_sealing: bytes) -> bytes:
    """To the robot's X25519 key. Raises ROSTER_INVALID."""
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
    """Return whether a row's keys are valid; the chain checks only their size."""
    try:
        seal_to(row.sealing, b"")
    except BlockRobotError:
        return False
    return is_public_key(row.spend) and is_public_key(row.view)


def open_roster(
    sealed: bytes,
    sealing_private: bytes,
    *,
    now_ms: int,
    robot: bytes | None = None,
    chain_id: bytes | None = None,
) -> tuple[Roster, bytes]:
    """Open a sealed roster; check form and age, and `robot` and `chain_id` if given.

    Return it and the key (33 bytes) that signed it: whether that is a registrar's only the chain can say. Raises
    ROSTER_INVALID, ROSTER_EXPIRED (also if not yet valid).
    """
    try:
        signed = decode(open_sealed(sealing_private, sealed), SignedRoster)
        signer = recover(ROSTER_TAG, signed.signature, signed.roster)
        roster = decode(signed.roster, Roster)
    except BlockRobotError:
        raise BlockRobotError("ROSTER_INVALID") from None
    _check_form(roster)
    if robot is not None and roster.robot != robot:
        raise BlockRobotError("ROSTER_INVALID", "The roster is for another robot.")
    if chain_id is not None and roster.chain_id != chain_id:
        raise BlockRobotError("ROSTER_INVALID", "The roster is of another network.")
    if not roster.issued_at_ms - ROSTER_CLOCK_TOLERANCE_MS <= now_ms < roster.not_after_ms:
        raise BlockRobotError("ROSTER_EXPIRED")
    return roster, signer


def verify_row(row: RosterRow, state_root: bytes) -> bytes:
    """Check a row against a 32-byte state root; return its member key. Raises ROSTER_INVALID."""
    try:
        shown = decode(row.proof, RowProof)
        verify_proof(state_root, MEMBER.key(shown.member), shown.value, shown.proof)
        member: Any = decode_value(shown.value)
    except BlockRobotError:
        raise BlockRobotError("ROSTER_INVALID", "A row's proof does not lead to the state root.") from None
    row_values = (row.handle, row.spend, row.view, row.sealing, "active")
    if row_values != tuple(member.get(name) for name in ("handle", "spend", "view", "sealing", "status")):
        raise BlockRobotError("ROSTER_INVALID", "The chain says otherwise of a member than the roster.")
    return shown.member
