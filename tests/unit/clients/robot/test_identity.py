"""A robot's keys and its roster of the day: made once, for its user only, and for no other robot or network."""

from __future__ import annotations

import secrets
from pathlib import Path

import msgspec
import pytest

from clients.robot.identity import RobotIdentity, create_identity, load_identity
from clients.robot.rosters import load_roster
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.keys import PrivateKey
from consensus.records.roster import ROSTER_LIFETIME_MAX_MS, ROSTER_VERSION, Roster, RosterRow, roster_tag, seal_roster
from tests.unit.clients.wallet.conftest import NOW_MS, make_genesis

REGISTRAR = PrivateKey(bytes([2] * 32))
UID = "E200000000000001"


def code_of(error: pytest.ExceptionInfo[BlockRobotError]) -> str:
    return error.value.code


def test_keys_are_found_again_and_are_for_the_user_only(tmp_path: Path) -> None:
    made = create_identity(tmp_path / "robot")
    again = load_identity(tmp_path / "robot")
    assert (again.identity.secret, again.sealing, again.spool) == (made.identity.secret, made.sealing, made.spool)
    assert (tmp_path / "robot" / "robot.keys").stat().st_mode & 0o777 == 0o600


def test_a_robot_is_never_overwritten(tmp_path: Path) -> None:
    made = create_identity(tmp_path)
    with pytest.raises(BlockRobotError) as caught:
        create_identity(tmp_path)
    assert code_of(caught) == "ROBOT_EXISTS"
    assert load_identity(tmp_path).spool == made.spool


def test_five_different_keys_are_drawn(tmp_path: Path) -> None:
    made = create_identity(tmp_path)
    secrets_of = {made.identity.secret, made.spend.secret, made.view.secret, made.sealing, made.spool}
    assert len(secrets_of) == 5


def test_no_secret_shows_when_a_robot_is_printed(tmp_path: Path) -> None:
    made = create_identity(tmp_path)
    for secret in (made.identity.secret, made.spend.secret, made.view.secret, made.sealing, made.spool):
        assert secret.hex() not in repr(made)
        assert repr(secret) not in repr(made)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"x",
        msgspec.msgpack.encode({"version": 1}),
        msgspec.msgpack.encode(
            dict.fromkeys(("version",), 1) | dict.fromkeys(("identity", "spend", "view", "sealing", "spool"), b"short")
        ),
    ],
    ids=["empty", "noise", "partial", "short keys"],
)
def test_a_missing_or_damaged_key_file_is_named(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(BlockRobotError) as caught:
        load_identity(tmp_path)
    assert code_of(caught) == "ROBOT_NOT_FOUND"
    (tmp_path / "robot.keys").write_bytes(content)
    with pytest.raises(BlockRobotError) as caught:
        load_identity(tmp_path)
    assert code_of(caught) == "DATA_DIRECTORY_INVALID"


@pytest.fixture
def robot(tmp_path: Path) -> RobotIdentity:
    return create_identity(tmp_path / "robot")


def sealed_roster(robot: RobotIdentity, genesis: Genesis, registrar: PrivateKey = REGISTRAR) -> bytes:
    key = secrets.token_bytes(32)
    row = RosterRow(
        tag=roster_tag(key, UID),
        handle=b"h" * 32,
        spend=REGISTRAR.public_key,
        view=REGISTRAR.public_key,
        sealing=bytes(32),
        proof=b"",
    )
    roster = Roster(
        ROSTER_VERSION,
        genesis.chain_id,
        robot.identity.public_key,
        key,
        NOW_MS,
        NOW_MS + ROSTER_LIFETIME_MAX_MS,
        (row,),
    )
    return seal_roster(roster, registrar, robot.sealing_public)


def test_a_roster_tells_whose_a_tag_is(robot: RobotIdentity, tmp_path: Path) -> None:
    path = tmp_path / "roster.sealed"
    path.write_bytes(sealed_roster(robot, make_genesis()))
    book = load_roster(path, robot, make_genesis(), NOW_MS)
    found = book.find(f" {UID.lower()}\n", NOW_MS)
    assert (len(book), found and found.handle) == (1, b"h" * 32)
    assert book.find("E200000000000002", NOW_MS) is None


def test_a_roster_is_of_today_of_this_network_and_of_a_registrar(robot: RobotIdentity, tmp_path: Path) -> None:
    genesis, path = make_genesis(), tmp_path / "roster.sealed"
    other = msgspec.structs.replace(genesis, network="another")
    wrong: list[tuple[bytes | None, int, str]] = [
        (None, NOW_MS, "ROSTER_INVALID"),
        (b"", NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(robot, genesis, PrivateKey(bytes([1] * 32))), NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(robot, other), NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(create_identity(tmp_path / "other"), genesis), NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(robot, genesis), NOW_MS + ROSTER_LIFETIME_MAX_MS, "ROSTER_EXPIRED"),
    ]
    for content, now_ms, code in wrong:
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(BlockRobotError) as caught:
            load_roster(path, robot, genesis, now_ms)
        assert code_of(caught) == code
