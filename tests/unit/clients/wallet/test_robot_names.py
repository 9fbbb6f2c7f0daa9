"""A robot's name beside its key, in each language; and asking for it joins no two visits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clients.wallet.commands import records_commands
from clients.wallet.ledger.robot_names import read_robot_names, robot_label
from clients.wallet.page.wallet_snapshot import Snapshot, read_snapshot
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE
from consensus.state.identity import RobotName, read_robot_name
from tests.world.commands import open_for_commands
from tests.world.sharing import SharedWard

CALLED = ("Zé", "Ala 4")


def name_robot(ward: SharedWard) -> None:
    ward.chain.must(ward.chain.admin, "identity", "name_robot", ward.chain.robot.handle, *CALLED)


@pytest.fixture
def ward(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SharedWard:
    ward = SharedWard(tmp_path)
    open_for_commands(monkeypatch, lambda: ward.wallet)
    return ward


@pytest.mark.parametrize(("language", "words"), [("en", "at robot"), ("pt", "robô")])
def test_records_name_the_robot_beside_its_key(
    ward: SharedWard, monkeypatch: pytest.MonkeyPatch, language: str, words: str
) -> None:
    ward.record_visit(1)
    key = ward.chain.robot.identity.public_key.hex()
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    bare = CliRunner().invoke(records_commands.records, [])
    assert f"{words} {key[:10]}" in bare.output
    name_robot(ward)
    told = CliRunner().invoke(records_commands.records, [])
    assert f"{words} Zé (Ala 4; {key[:10]})" in " ".join(told.output.split())
    answer = json.loads(CliRunner().invoke(records_commands.records, ["--json"]).stdout)
    (visit,) = answer["visits"]
    assert (visit["robot"], visit["robot_name"], visit["robot_place"]) == (key, *CALLED)


async def test_a_robot_is_asked_for_in_the_session_of_a_visit_of_its_own(
    ward: SharedWard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked together, or by the member's key, a node would learn that one person met these robots."""
    ward.record_visit(1)
    name_robot(ward)
    (visit,) = ward.wallet.store.content.visits or await ward.wallet.scan()
    other = type(visit)(**{name: getattr(visit, name) for name in visit.__struct_fields__} | {"robot": bytes(33)})
    asked: list[tuple[list[bytes], bytes]] = []
    values = ward.wallet.values

    async def spy(keys: list[bytes], session: Any) -> dict[bytes, Any]:
        asked.append((keys, session.public_key))
        return await values(keys, visit_key)

    visit_key = ward.wallet.owner_key(visit)
    monkeypatch.setattr(ward.wallet, "values", spy)
    names = await read_robot_names(ward.wallet, [visit, other])
    assert names == {visit.robot: RobotName(*CALLED)}
    assert [len(keys) for keys, _ in asked] == [1, 1]
    for (key,), session in asked:
        robot = next(each for each in (visit, other) if key.endswith(each.robot))
        assert session == ward.wallet.owner_key(robot).public_key != ward.wallet.keys.identity.public_key
    assert robot_label(other.robot, names) == "0" * 10


async def test_a_page_that_is_open_asks_once(ward: SharedWard, monkeypatch: pytest.MonkeyPatch) -> None:
    ward.record_visit(1)
    name_robot(ward)
    first = await read_snapshot(ward.wallet, Snapshot(), ward.chain.time_ms)
    assert list(first.robot_names.values()) == [RobotName(*CALLED)]
    monkeypatch.setattr("clients.wallet.page.wallet_snapshot.read_robot_names", None)
    again = await read_snapshot(ward.wallet, first, ward.chain.time_ms)
    assert again.robot_names == first.robot_names


@pytest.mark.parametrize(
    "value",
    [
        None,
        b"Robbie",
        {"name": "Robbie"},
        {"name": "", "place": "Ward 4"},
        {"name": 3, "place": ""},
        {"name": "x" * 33, "place": ""},
        {"name": "Robbie\x1b[2J", "place": ""},
        {"name": "Robbie", "place": "\u202eWard"},
    ],
)
def test_what_cannot_be_shown_is_no_name(value: Any) -> None:
    assert read_robot_name(value) is None
