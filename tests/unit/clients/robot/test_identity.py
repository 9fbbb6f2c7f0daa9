"""A robot's keys and its roster of the day: made once, for its user only, and for no other robot or network."""

from __future__ import annotations

import secrets
from pathlib import Path

import msgspec
import pytest
from nacl import pwhash

from clients.robot.cli.robot_choice import CREDENTIAL, RobotPlace, read_passphrase
from clients.robot.identity.robot_keys import (
    RobotIdentity,
    change_passphrase,
    create_identity,
    is_sealed,
    load_identity,
)
from clients.robot.pairing.rosters import RosterBook, load_roster
from clients.sdk.passphrase import PassphraseCost
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.members.roster import ROSTER_LIFETIME_MAX_MS, ROSTER_VERSION, Roster, RosterRow, roster_tag, seal_roster
from consensus.primitives.keys import PrivateKey
from tests.world.dicts import NOW_MS, make_genesis

REGISTRAR = PrivateKey(bytes([2] * 32))
CHEAP = PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN)
UID = "E200000000000001"


def code_of(error: pytest.ExceptionInfo[BlockRobotError]) -> str:
    return error.value.code


def test_keys_are_found_again_for_the_user_only_and_never_overwritten(tmp_path: Path) -> None:
    made = create_identity(tmp_path / "robot")
    again = load_identity(tmp_path / "robot")
    assert (again.identity.secret, again.sealing, again.spool) == (made.identity.secret, made.sealing, made.spool)
    assert (tmp_path / "robot" / "robot.keys").stat().st_mode & 0o777 == 0o600
    made = create_identity(tmp_path)
    with pytest.raises(BlockRobotError) as caught:
        create_identity(tmp_path)
    assert code_of(caught) == "ROBOT_EXISTS"
    assert load_identity(tmp_path).spool == made.spool


def test_a_robot_whose_keys_cannot_be_sealed_is_not_left_half_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr("clients.robot.identity.robot_keys.new_sealing_key", fail)
        with pytest.raises(MemoryError):
            create_identity(tmp_path, "four fine words here")
    assert list(tmp_path.iterdir()) == []
    create_identity(tmp_path)


def test_five_different_keys_are_drawn_and_none_shows_when_a_robot_is_printed(tmp_path: Path) -> None:
    made = create_identity(tmp_path)
    secrets_of = {made.identity.secret, made.spend.secret, made.view.secret, made.sealing, made.spool}
    assert len(secrets_of) == 5
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


def test_a_sealed_key_file_opens_with_its_passphrase_alone(tmp_path: Path) -> None:
    made = create_identity(tmp_path, "tea and lemon", CHEAP)
    assert is_sealed(tmp_path)
    content = (tmp_path / "robot.keys").read_bytes()
    assert not any(key in content for key in (made.identity.secret, made.spool, made.sealing))
    assert load_identity(tmp_path, "tea and lemon").spool == made.spool
    for passphrase, code in ((None, "ROBOT_PASSPHRASE_MISSING"), ("coffee", "ROBOT_PASSPHRASE_WRONG")):
        with pytest.raises(BlockRobotError) as caught:
            load_identity(tmp_path, passphrase)
        assert code_of(caught) == code


def test_a_passphrase_is_put_on_changed_and_taken_off(tmp_path: Path) -> None:
    made = create_identity(tmp_path)
    for old, new in ((None, "tea"), ("tea", "coffee"), ("coffee", None)):
        change_passphrase(tmp_path, old, new, CHEAP)
        assert is_sealed(tmp_path) == (new is not None)
        assert load_identity(tmp_path, new).spool == made.spool
        assert (tmp_path / "robot.keys").stat().st_mode & 0o777 == 0o600
    change_passphrase(tmp_path, None, "tea", CHEAP)
    before = (tmp_path / "robot.keys").read_bytes()
    with pytest.raises(BlockRobotError):
        change_passphrase(tmp_path, "coffee", None, CHEAP)
    assert (tmp_path / "robot.keys").read_bytes() == before


@pytest.mark.parametrize("place", range(0, 250, 7))
def test_a_sealed_file_that_was_changed_is_damaged_whatever_the_passphrase(tmp_path: Path, place: int) -> None:
    create_identity(tmp_path, "tea", CHEAP)
    path = tmp_path / "robot.keys"
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    with pytest.raises(BlockRobotError) as caught:
        load_identity(tmp_path, "tea")
    assert code_of(caught) == "DATA_DIRECTORY_INVALID"


@pytest.mark.parametrize("content", [b"", b"\ntea", b"\xff\xfe", b"x" * 5_000])
def test_a_file_that_holds_no_passphrase_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "pass"
    file.write_bytes(content)
    with pytest.raises(BlockRobotError) as caught:
        read_passphrase(file)
    assert code_of(caught) == "REQUEST_INVALID"


def test_a_unit_of_systemd_is_handed_the_passphrase_as_a_credential(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = create_identity(tmp_path / "robot", "tea", CHEAP)
    (tmp_path / CREDENTIAL).write_text("tea\r\n")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert RobotPlace(tmp_path / "robot", tmp_path / "genesis.json").load().spool == made.spool
    monkeypatch.delenv("CREDENTIALS_DIRECTORY")
    with pytest.raises(BlockRobotError) as caught:
        RobotPlace(tmp_path / "robot", tmp_path / "genesis.json").load()
    assert code_of(caught) == "ROBOT_PASSPHRASE_MISSING"


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
        sealing=bytes([9] * 32),
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


LOW_ORDER = b"\x01" + bytes(31)


@pytest.mark.parametrize(
    "changed", [{"spend": bytes(33)}, {"view": b"\x02" + b"\xff" * 32}, {"sealing": bytes(32)}, {"sealing": LOW_ORDER}]
)
def test_somebody_with_keys_that_are_none_is_nobody_the_robot_knows(changed: dict[str, bytes]) -> None:
    key, point = bytes(32), REGISTRAR.public_key
    rows = [
        RosterRow(roster_tag(key, uid), bytes([place] * 32), point, point, bytes([9] * 32), b"")
        for place, uid in enumerate((UID, "OTHER"))
    ]
    rows[1] = msgspec.structs.replace(rows[1], **changed)
    book = RosterBook(Roster(ROSTER_VERSION, bytes(32), bytes(33), key, 0, 10, tuple(rows)), REGISTRAR.public_key)
    assert (book.find(UID, 5), book.find("OTHER", 5)) == (rows[0], None)


def test_a_roster_tells_whose_a_tag_is(robot: RobotIdentity, tmp_path: Path) -> None:
    path = tmp_path / "roster.sealed"
    path.write_bytes(sealed_roster(robot, make_genesis()))
    book = load_roster(path, robot, make_genesis().chain_id, NOW_MS)
    found = book.find(f" {UID.lower()}\n", NOW_MS)
    assert (len(book), found and found.handle) == (1, b"h" * 32)
    assert book.find("E200000000000002", NOW_MS) is None


def test_a_roster_is_of_today_of_this_network_and_of_this_robot(robot: RobotIdentity, tmp_path: Path) -> None:
    genesis, path = make_genesis(), tmp_path / "roster.sealed"
    other = msgspec.structs.replace(genesis, network="another")
    wrong: list[tuple[bytes | None, int, str]] = [
        (None, NOW_MS, "ROSTER_INVALID"),
        (b"", NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(robot, other), NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(create_identity(tmp_path / "other"), genesis), NOW_MS, "ROSTER_INVALID"),
        (sealed_roster(robot, genesis), NOW_MS + ROSTER_LIFETIME_MAX_MS, "ROSTER_EXPIRED"),
    ]
    for content, now_ms, code in wrong:
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(BlockRobotError) as caught:
            load_roster(path, robot, genesis.chain_id, now_ms)
        assert code_of(caught) == code
