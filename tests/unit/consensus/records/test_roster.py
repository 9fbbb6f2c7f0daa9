"""Rosters: opened by their robot alone, signed by a registrar, good for a day, and true to the chain."""

from __future__ import annotations

import msgspec
import pytest
from nacl.public import PrivateKey as SealingKey

from consensus.errors import BlockRobotError
from consensus.members.roster import (
    ROSTER_LIFETIME_MAX_MS,
    ROSTER_VERSION,
    Roster,
    RosterRow,
    RowProof,
    open_roster,
    roster_tag,
    seal_roster,
    verify_row,
)
from consensus.primitives.encoding import encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from contracts.state.view import MemoryState

CHAIN, KEY = sha256(b"chain"), sha256(b"roster key")
REGISTRAR = PrivateKey(sha256(b"registrar"))
ROBOT = PrivateKey(sha256(b"robot")).public_key
MEMBER, SPEND, VIEW = (PrivateKey(sha256(name)).public_key for name in (b"m", b"s", b"v"))
ROBOT_SEALING = bytes(range(32))
ROBOT_SEALING_PUBLIC = bytes(SealingKey(ROBOT_SEALING).public_key)
NOW = 1_800_000_000_000
UID = "E2801160600002071234ABCD"


def _row(proof: bytes = b"", uid: str = UID) -> RosterRow:
    return RosterRow(
        tag=roster_tag(KEY, uid), handle=sha256(b"handle"), spend=SPEND, view=VIEW, sealing=sha256(b"x"), proof=proof
    )


def _roster(*rows: RosterRow) -> Roster:
    return Roster(
        version=ROSTER_VERSION,
        chain_id=CHAIN,
        robot=ROBOT,
        key=KEY,
        issued_at_ms=NOW,
        not_after_ms=NOW + ROSTER_LIFETIME_MAX_MS,
        rows=rows or (_row(),),
    )


def _open(sealed: bytes, now_ms: int = NOW + 1, **expected: bytes) -> Roster:
    roster, signer = open_roster(sealed, ROBOT_SEALING, now_ms=now_ms, **expected)
    assert signer == REGISTRAR.public_key
    return roster


def test_a_robot_opens_its_roster_and_finds_a_tag() -> None:
    sealed = seal_roster(_roster(), REGISTRAR, ROBOT_SEALING_PUBLIC)
    roster = _open(sealed, robot=ROBOT, chain_id=CHAIN)
    assert roster == _roster()
    assert {row.tag for row in roster.rows} == {roster_tag(roster.key, " " + UID.lower())}


def test_no_form_of_the_uid_is_in_the_roster() -> None:
    data = encode(_roster())
    for form in (UID.encode(), UID.lower().encode(), bytes.fromhex(UID), sha256(UID.encode())):
        assert form not in data


def test_another_robot_cannot_open_it() -> None:
    sealed = seal_roster(_roster(), REGISTRAR, ROBOT_SEALING_PUBLIC)
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        open_roster(sealed, sha256(b"other"), now_ms=NOW)
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        _open(sealed, robot=MEMBER)
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        _open(sealed, chain_id=bytes(32))


def test_a_roster_tells_who_signed_it() -> None:
    thief = PrivateKey(sha256(b"thief"))
    _, signer = open_roster(seal_roster(_roster(), thief, ROBOT_SEALING_PUBLIC), ROBOT_SEALING, now_ms=NOW + 1)
    assert signer == thief.public_key


@pytest.mark.parametrize("place", [0, 40, -1])
def test_a_changed_roster_is_refused(place: int) -> None:
    sealed = bytearray(seal_roster(_roster(), REGISTRAR, ROBOT_SEALING_PUBLIC))
    sealed[place] ^= 1
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        _open(bytes(sealed))


@pytest.mark.parametrize("now_ms", [NOW + ROSTER_LIFETIME_MAX_MS, NOW - 3_600_000])
def test_a_roster_of_another_day_is_refused(now_ms: int) -> None:
    sealed = seal_roster(_roster(), REGISTRAR, ROBOT_SEALING_PUBLIC)
    with pytest.raises(BlockRobotError, match="ROSTER_EXPIRED"):
        _open(sealed, now_ms)


@pytest.mark.parametrize(
    "change",
    [
        {"not_after_ms": NOW + ROSTER_LIFETIME_MAX_MS + 1},
        {"not_after_ms": NOW},
        {"key": bytes(31)},
        {"version": ROSTER_VERSION + 1},
        {"rows": (_row(), _row())},
        {"rows": (msgspec.structs.replace(_row(), spend=bytes(32)),)},
    ],
)
def test_a_roster_outside_the_limits_is_never_sealed(change: dict[str, object]) -> None:
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        seal_roster(msgspec.structs.replace(_roster(), **change), REGISTRAR, ROBOT_SEALING_PUBLIC)


def _state(status: str = "active", spend: bytes = SPEND) -> tuple[MemoryState, bytes]:
    value = encode_value(
        {
            "handle": sha256(b"handle"),
            "role": "subject",
            "org": "ward",
            "spend": spend,
            "view": VIEW,
            "sealing": sha256(b"x"),
            "status": status,
            "since": NOW,
        }
    )
    state = MemoryState()
    state.apply({b"identity\x00member/" + MEMBER: value, b"other\x00key": b"\x01"})
    return state, value


def _proven(state: MemoryState, value: bytes) -> RosterRow:
    proof = state.prove(b"identity\x00member/" + MEMBER)
    return _row(encode(RowProof(member=MEMBER, value=value, proof=proof)))


def test_a_row_is_proven_against_the_state_with_the_chains_keys() -> None:
    state, value = _state()
    assert verify_row(_proven(state, value), state.state_root) == MEMBER
    state, value = _state(spend=VIEW)
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        verify_row(_proven(state, value), state.state_root)
    state, value = _state(status="left")
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        verify_row(_proven(state, value), state.state_root)
    state, value = _state()
    for row, root in ((_proven(state, value), bytes(32)), (_row(), state.state_root)):
        with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
            verify_row(row, root)
