"""The registrar's desk: who may sit at it, what it keeps, what it hands out."""

from __future__ import annotations

import secrets
import stat
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from nacl.public import PrivateKey as SealingPrivateKey
from rich.console import Console

from clients.registrar.cli import LAST_LATIN, card
from clients.registrar.registrar import CARD_LIFETIME_DEFAULT_MS, Registrar
from clients.sdk.proof_checks import ProvedState
from clients.sdk.trust_pin import PIN_FILE
from consensus.errors import BlockRobotError
from consensus.members.roster import Roster, open_roster, roster_tag
from consensus.members.vouchers import decode_card_code, recover_registrar
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import HANDLE, MEMBER, MemberRow
from consensus.state.identity import REGISTRAR as REGISTRAR_ROW
from consensus.state.keys import to_value
from tests.world.dicts import NOW_MS, make_genesis

REGISTRAR = PrivateKey(bytes([2] * 32))
LATER = PrivateKey(bytes([8] * 32))
UID = "E2801160600002054A1B2C3D"
ROBOT = PrivateKey(bytes([6] * 32)).public_key
ROBOT_SEALING = SealingPrivateKey(bytes([11] * 32))


class FixedClock:
    def now_ms(self) -> int:
        return NOW_MS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "registrar.key").write_bytes(REGISTRAR.secret)
    return tmp_path


@pytest.fixture
def desk(folder: Path) -> Registrar:
    return Registrar(folder, make_genesis(), FixedClock())


def test_a_sign_that_no_robots_name_holds_is_named() -> None:
    said = CliRunner().invoke(card, ["name", "Jörg Müller", "--place", "Süd – 4", "--robot", "02" + 32 * "ab"])
    assert said.exit_code == 2
    assert "'–' (U+2013) cannot stand there" in " ".join(said.output.split())
    contract = Path(__file__).parents[4] / "contracts" / "privacy" / "identity.py"
    assert f'LAST_LATIN = "\\u{ord(LAST_LATIN):04x}"' in contract.read_text()


def code_of(error: pytest.ExceptionInfo[BlockRobotError]) -> str:
    return error.value.code


def test_without_a_key_there_is_no_desk(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError) as caught:
        Registrar(tmp_path, make_genesis())
    assert code_of(caught) == "ORGANISATION_KEY_NOT_FOUND"


def test_a_desk_is_of_the_organisation_whose_key_is_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setattr("clients.registrar.cli.load_genesis", lambda _: make_genesis())
    place, first, organisation = tmp_path / "network", make_genesis().organisations[0].name, "clinic"
    for name in (first, organisation):
        (place / "organisations" / name).mkdir(parents=True)
    (tmp_path / "uid").write_text(UID)
    issue = ["issue", "--uid-file", str(tmp_path / "uid"), "--out", str(tmp_path / "card.txt")]
    refused = CliRunner().invoke(card, issue)
    assert (refused.exit_code, "ORGANISATION_KEY_NOT_FOUND" in refused.output) == (3, True)
    assert "--registrar-dir" in refused.output
    (place / "organisations" / organisation / "registrar.key").write_bytes(REGISTRAR.secret)
    issued = CliRunner().invoke(card, issue)
    assert issued.exit_code == 0, issued.output
    assert (place / "organisations" / organisation / "cards.json").exists()
    (place / "organisations" / first / "registrar.key").write_bytes(REGISTRAR.secret)
    assert CliRunner().invoke(card, [*issue[:-1], str(tmp_path / "second.txt")]).exit_code == 0
    assert (place / "organisations" / first / "cards.json").exists(), "of several, the network's first"


def test_a_card_carries_a_voucher_of_this_registrar_for_this_chain(desk: Registrar) -> None:
    card = decode_card_code(desk.issue(UID, "subject"))
    assert recover_registrar(card, make_genesis().chain_id) == REGISTRAR.public_key
    assert recover_registrar(card, bytes(32)) != REGISTRAR.public_key
    assert (card.role, card.not_after_ms) == ("subject", NOW_MS + CARD_LIFETIME_DEFAULT_MS)


def test_nothing_of_the_uid_is_in_the_code(desk: Registrar) -> None:
    """The same tag twice: no byte of either code can be predicted from the UID."""
    first, second = decode_card_code(desk.issue(UID, "subject")), decode_card_code(desk.issue(UID, "subject"))
    assert first.handle != second.handle
    assert first.card_secret != second.card_secret


def test_a_reissued_tag_has_one_handle_the_new_one(desk: Registrar) -> None:
    desk.issue(UID, "subject")
    desk.issue("0BADF00D", "staff")
    again = decode_card_code(desk.issue(f"  {UID.lower()}\n", "subject"))
    in_use = [entry for entry in desk.cards() if not entry.superseded]
    assert [(entry.uid, entry.role) for entry in in_use] == [("0BADF00D", "staff"), (UID, "subject")]
    assert in_use[1].handle == again.handle.hex()


async def test_a_roster_names_who_registered_with_a_superseded_card(desk: Registrar, chain: dict[Any, Any]) -> None:
    first = register(desk, chain, UID, "subject")
    desk.issue(UID, "subject")
    made = await desk.make_roster(ROBOT)
    assert (made.rows, made.superseded) == (0, (chain[HANDLE.key(first)],))
    await desk.revoke(made.superseded[0])
    second = register(desk, chain, UID, "subject")
    again = await desk.make_roster(ROBOT)
    assert ([row.handle for row in opened(again.sealed).rows], again.superseded) == ([second], ())


def test_the_list_of_cards_is_for_its_user_only_and_survives_a_restart(desk: Registrar, folder: Path) -> None:
    desk.issue(UID, "subject")
    (folder / ".cards.json.tmp").touch(mode=0o644)
    desk.issue("0BADF00D", "subject")
    assert stat.S_IMODE((folder / "cards.json").stat().st_mode) == 0o600
    assert sorted(path.name for path in folder.iterdir()) == ["cards.json", "registrar.key"]
    assert Registrar(folder, make_genesis()).cards() == desk.cards()


@pytest.mark.parametrize("content", ["", "{", '[{"uid": "A"}]', '{"uid": 1}'])
def test_a_damaged_list_is_said_to_be_damaged_and_not_overwritten(desk: Registrar, folder: Path, content: str) -> None:
    (folder / "cards.json").write_text(content, encoding="utf-8")
    with pytest.raises(BlockRobotError) as caught:
        desk.issue(UID, "subject")
    assert code_of(caught) == "DATA_DIRECTORY_INVALID"
    assert (folder / "cards.json").read_text(encoding="utf-8") == content


def test_an_empty_uid_and_an_unknown_role_make_no_card(desk: Registrar) -> None:
    for uid, role in ((" \n", "subject"), (UID, "emperor")):
        with pytest.raises(BlockRobotError):
            desk.issue(uid, role)
    assert desk.cards() == []


class FakeClient:
    """A network's proven state, asked in the registrar's session."""

    state: dict[bytes, Any] = {}  # noqa: RUF012 - set anew by each test
    calls: list[tuple[str, list[Any]]] = []  # noqa: RUF012 - set anew by each test

    def __init__(self, genesis: object, path: Path) -> None:
        assert path.name == PIN_FILE
        self.asked: list[bytes] = []

    async def __aenter__(self) -> FakeClient:
        return self

    async def __aexit__(self, *exception: object) -> None:
        """Nothing is open."""

    async def call(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> SimpleNamespace:
        assert (key.public_key, contract) == (REGISTRAR.public_key, "identity")
        self.calls.append((entry, arguments))
        if entry != "revoke":
            return SimpleNamespace(txid=b"n" * 32)
        (handle,) = arguments
        self.state[MEMBER.key(self.state[HANDLE.key(handle)])]["status"] = "revoked"
        return SimpleNamespace(txid=b"t" * 32)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        assert key.public_key in {REGISTRAR.public_key, LATER.public_key}
        return ProvedState(1, NOW_MS, {flat: self.state.get(flat) for flat in keys})


def member_state(
    role: str, status: Any = "active", sealing: bytes = bytes(32), handle: bytes = bytes(32)
) -> dict[str, Any]:
    spend, view = (PrivateKey(secrets.token_bytes(32)).public_key for _ in range(2))
    row: dict[str, Any] = to_value(MemberRow(handle, role, "hospital", spend, view, sealing, status, 0))
    return row


@pytest.fixture
def chain(monkeypatch: pytest.MonkeyPatch) -> dict[bytes, Any]:
    robot = member_state("robot", sealing=bytes(ROBOT_SEALING.public_key))
    FakeClient.calls = []
    FakeClient.state = {MEMBER.key(ROBOT): robot}
    monkeypatch.setattr("clients.registrar.registrar.open_pinned_client", FakeClient)
    return FakeClient.state


def register(desk: Registrar, chain: dict[bytes, Any], uid: str, role: str, **state: Any) -> bytes:
    handle = decode_card_code(desk.issue(uid, role)).handle
    member = secrets.token_bytes(33)
    chain[HANDLE.key(handle)] = member
    chain[MEMBER.key(member)] = member_state(role, handle=handle, **state)
    return handle


def opened(sealed: bytes) -> Roster:
    roster, signer = open_roster(
        sealed, bytes(ROBOT_SEALING), now_ms=NOW_MS, robot=ROBOT, chain_id=make_genesis().chain_id
    )
    assert signer == REGISTRAR.public_key
    return roster


async def test_a_registrar_of_the_genesis_file_needs_no_network_to_know_whose_it_is(desk: Registrar) -> None:
    assert await desk.find_organisation() == make_genesis().organisations[0].name


@pytest.mark.parametrize("known", [True, False])
async def test_a_later_registrar_is_one_by_the_chain_alone(
    tmp_path: Path, chain: dict[bytes, Any], *, known: bool
) -> None:
    (tmp_path / "registrar.key").write_bytes(LATER.secret)
    desk = Registrar(tmp_path, make_genesis(), FixedClock())
    if known:
        chain[REGISTRAR_ROW.key(LATER.public_key)] = "clinic"
        assert await desk.find_organisation() == "clinic"
        return
    with pytest.raises(BlockRobotError) as caught:
        await desk.find_organisation()
    assert code_of(caught) == "DATA_DIRECTORY_INVALID"


async def test_a_roster_has_whoever_registered_and_nobody_else(desk: Registrar, chain: dict[Any, Any]) -> None:
    ann = register(desk, chain, UID, "subject")
    nurse = register(desk, chain, "0BADF00D", "staff")
    register(desk, chain, "DEADBEEF", "subject", status="left")
    register(desk, chain, "ABCDEF01", "officer")
    desk.issue("NOT-YET-REGISTERED", "subject")
    made = await desk.make_roster(ROBOT)
    sealed = made.sealed
    assert (made.rows, made.superseded) == (2, ())
    assert {row.handle for row in opened(sealed).rows} == {ann, nurse}


async def test_a_roster_finds_a_tag_without_holding_it(desk: Registrar, chain: dict[Any, Any]) -> None:
    handle = register(desk, chain, UID, "subject")
    sealed = (await desk.make_roster(ROBOT)).sealed
    roster = opened(sealed)
    assert {row.tag: row.handle for row in roster.rows}[roster_tag(roster.key, UID)] == handle
    assert UID.encode() not in sealed
    assert UID not in repr(roster)


async def test_two_rosters_cannot_be_joined_by_their_tags(desk: Registrar, chain: dict[Any, Any]) -> None:
    register(desk, chain, UID, "subject")
    first, second = [opened((await desk.make_roster(ROBOT)).sealed) for _ in range(2)]
    assert first.rows[0].tag != second.rows[0].tag


@pytest.mark.parametrize("change", [{"role": "subject"}, {"status": "revoked"}])
async def test_only_an_active_robot_gets_a_roster(
    desk: Registrar, chain: dict[Any, Any], change: dict[str, str]
) -> None:
    chain[MEMBER.key(ROBOT)].update(change)
    with pytest.raises(BlockRobotError) as caught:
        await desk.make_roster(ROBOT)
    assert code_of(caught) == "NOT_FOUND"


def uids(desk: Registrar) -> list[str]:
    return [card.uid for card in desk.cards()]


class LaterClock:
    def now_ms(self) -> int:
        return NOW_MS + CARD_LIFETIME_DEFAULT_MS + 1


async def test_the_desk_forgets_who_left_or_was_revoked_and_codes_that_expired(
    desk: Registrar, folder: Path, chain: dict[Any, Any]
) -> None:
    register(desk, chain, UID, "subject")
    register(desk, chain, "DEADBEEF", "subject", status="left")
    register(desk, chain, "0BADF00D", "staff", status="revoked")
    desk.issue("NOT-YET-REGISTERED", "subject")
    assert await desk.forget_former() == 2
    assert uids(desk) == [UID, "NOT-YET-REGISTERED"]
    later = Registrar(folder, make_genesis(), LaterClock())
    assert await later.forget_former() == 1
    assert uids(desk) == [UID], "a registered card is kept beyond its code's time"
    assert b"DEADBEEF" not in (folder / "cards.json").read_bytes()


async def test_making_a_roster_forgets_them_too(desk: Registrar, chain: dict[Any, Any]) -> None:
    register(desk, chain, UID, "subject")
    register(desk, chain, "DEADBEEF", "subject", status="left")
    await desk.make_roster(ROBOT)
    assert uids(desk) == [UID]


def test_one_tag_is_forgotten_on_request(desk: Registrar) -> None:
    desk.issue(UID, "subject")
    desk.issue("0BADF00D", "staff")
    assert desk.forget(f" {UID.lower()}\n") == 1
    assert desk.forget(UID) == 0
    assert uids(desk) == ["0BADF00D"]


async def test_a_membership_is_ended_at_the_desk(desk: Registrar, chain: dict[Any, Any]) -> None:
    register(desk, chain, "0BADF00D", "robot")
    register(desk, chain, UID, "subject")
    member = await desk.get_member("0badf00d")
    assert await desk.get_role(member) == "robot"
    assert (await desk.revoke(member)).role == "robot"
    assert uids(desk) == [UID]
    for again in (desk.revoke(member), desk.get_role(member), desk.get_member("0BADF00D")):
        with pytest.raises(BlockRobotError) as caught:
            await again
        assert code_of(caught) == "NOT_FOUND"


async def test_a_robot_is_named_at_the_desk(desk: Registrar, chain: dict[Any, Any]) -> None:
    handle = register(desk, chain, "0BADF00D", "robot")
    assert await desk.name_robot(await desk.get_member("0badf00d"), "Robbie", "Ward 4") == b"n" * 32
    assert FakeClient.calls == [("name_robot", [handle, "Robbie", "Ward 4"])]
    with pytest.raises(BlockRobotError) as caught:
        await desk.name_robot(bytes(33), "Robbie", "")
    assert code_of(caught) == "NOT_FOUND"


@pytest.mark.parametrize("options", [[], ["--robot", "02ab", "--uid-file", "FILE"]])
def test_a_robot_to_be_named_is_said_in_one_way(tmp_path: Path, options: list[str]) -> None:
    (tmp_path / "uid").write_text("0BADF00D")
    given = [str(tmp_path / "uid") if option == "FILE" else option for option in options]
    result = CliRunner().invoke(card, ["name", "Robbie", *given])
    assert (result.exit_code, "--robot KEY or --uid-file FILE" in result.output) == (2, True)


def test_a_card_goes_to_a_file_and_stands_nowhere_else(
    tmp_path: Path, desk: Registrar, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clients.registrar.cli._open", lambda *_: desk)
    (tmp_path / "uid").write_text(UID)
    issue, out = ["issue", "--uid-file", str(tmp_path / "uid")], tmp_path / "card.txt"
    told = CliRunner().invoke(card, [*issue, "--out", str(out)])
    assert told.exit_code == 0, told.output
    code = out.read_text().strip()
    assert decode_card_code(code).role == "subject"
    assert code not in told.output
    assert "BR1-" not in CliRunner().invoke(card, [*issue, "--json", "--out", str(tmp_path / "card.html")]).output
    cards = desk.cards()
    for wrong in (out, tmp_path / "card.pdf"):
        refused = CliRunner().invoke(card, [*issue, "--out", str(wrong)])
        assert (refused.exit_code, "--out takes a new file" in refused.output) == (2, True)
    refused = CliRunner().invoke(card, [*issue, "--out", str(tmp_path / "missing" / "card.html")])
    assert (refused.exit_code, "FILE_UNUSABLE" in refused.output) == (1, True)
    assert desk.cards() == cards, "no card is issued that cannot be written"


def test_on_a_terminal_the_code_is_shown_to_scan(
    tmp_path: Path, desk: Registrar, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clients.registrar.cli._open", lambda *_: desk)
    (tmp_path / "uid").write_text(UID)
    for width, is_shown in ((100, True), (40, False)):
        out = StringIO()
        monkeypatch.setattr("clients.registrar.cli.console", Console(file=out, force_terminal=True, width=width))
        assert CliRunner().invoke(card, ["issue", "--uid-file", str(tmp_path / "uid")]).exit_code == 0
        assert ("▀" in out.getvalue()) == is_shown
