"""The post-stage says no when a wallet has what it should not have, or misses what was changed."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from clients.sdk.pictures.picture_names import name_picture
from network.demo.checks import CheckList
from network.experiments import post_stage
from network.experiments.definitions import EXPERIMENTS
from network.experiments.post_stage import PostStage, WalletContents
from network.testbed import Stage

PEOPLE = ("patient-a", "patient-b")
IN_A_TIME, IN_B_TIME, A_ALONE_IN_B_WINDOW = 200, 700, 400


def said(**fields: Any) -> Any:
    """An answer with these fields alone, objects in it likewise."""
    return json.loads(json.dumps(fields), object_hook=lambda found: SimpleNamespace(**found))


class WalletsStandIn:
    """Wallets as the post-stage meets them: what each lists, sees and is refused."""

    def __init__(self) -> None:
        self.pictures = {"patient-a": [IN_A_TIME], "patient-b": [IN_B_TIME]}
        self.status: dict[str, str] = {}
        self.refusals = {"custodian-1": "NOT_PERMITTED"}
        self.view_refusal = "RECORD_NOT_FOUND"
        self.changed: list[tuple[str, int]] = []
        nodes = [SimpleNamespace(name="node-1"), SimpleNamespace(name="node-2")]
        self.cluster = SimpleNamespace(genesis=SimpleNamespace(custodians=nodes), config=lambda name: name)

    async def wallet(self, alias: str, _kind: type, *arguments: str) -> SimpleNamespace:
        record = {"record_id": alias.encode().hex(), "frames": len(self.pictures[alias])}
        frames = [
            {"number": index + 1, "status": self.status.get(f"{alias}/{index}", "ok")}
            for index in range(len(self.pictures[alias]))
        ]
        if arguments[0] == "records":
            visit = {"records": [record], "missing_records": 0, "closed": True}
            return said(visits=[visit] if self.pictures[alias] else [])
        if arguments[0] == "view":
            folder = Path(arguments[2]) / "record"
            folder.mkdir(parents=True)
            for index, number in enumerate(self.pictures[alias]):
                (folder / name_picture(index, number, "depth.png")).touch()
                (folder / name_picture(index, number, "png")).touch()
        if arguments[0] == "probe":
            return SimpleNamespace(refusals=self.refusals)
        if arguments[0] == "audit":
            return said(entries=[{"kind": "verdict", "records": [record["record_id"]]}])
        return said(records=[{"record_id": record["record_id"], "frames": frames}])

    async def refusal(self, alias: str, *arguments: str) -> str:
        return self.view_refusal


@pytest.fixture
def house(monkeypatch: pytest.MonkeyPatch) -> WalletsStandIn:
    made = WalletsStandIn()
    monkeypatch.setattr(post_stage, "worst_foreign_share", lambda *_: (0.0, 1))
    monkeypatch.setattr(
        post_stage, "flip_stored_byte", lambda config, record_id, index: made.changed.append((config, index))
    )
    return made


def look(house: WalletsStandIn, folder: Path, *, kept: int = 2, corrupt: bool = False, number: int = 3) -> list[str]:
    """Go through the post-stage of an experiment (the third); return the names of the checks that failed."""
    checks = CheckList(listener=lambda check: None)
    scene = EXPERIMENTS[number - 1].load_scene()
    stage = PostStage(cast(Stage, house), scene, folder, checks, lambda line: None)

    async def go() -> None:
        found: dict[str, WalletContents] = await stage.look(PEOPLE, kept)
        await (stage.corrupt_and_verify(found) if corrupt else stage.verify_untouched(found))

    asyncio.run(go())
    assert len(checks.checks) >= 11
    return [check.name for check in checks.checks if not check.ok]


def test_when_each_has_her_own_every_check_holds(house: WalletsStandIn, tmp_path: Path) -> None:
    assert look(house, tmp_path) == []


def test_a_frame_in_which_she_was_not_there_is_not_her_own_though_her_tags_time_covers_it(
    house: WalletsStandIn, tmp_path: Path
) -> None:
    house.pictures["patient-b"].append(A_ALONE_IN_B_WINDOW)
    assert look(house, tmp_path, kept=3) == ["patient B has their own data only"]


def test_a_frame_outside_her_tags_time_is_not_her_own(house: WalletsStandIn, tmp_path: Path) -> None:
    house.pictures["patient-a"].append(IN_B_TIME)
    assert look(house, tmp_path, kept=3) == ["patient A has their own data only"]


def test_a_picture_that_shows_another_is_told(
    house: WalletsStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(post_stage, "worst_foreign_share", lambda scenario, depths, alias: (0.01, 1))
    assert look(house, tmp_path) == ["patient A's pictures show nobody else", "patient B's pictures show nobody else"]


def test_where_others_were_there_some_pictures_must_have_been_judged(
    house: WalletsStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without one of them in a judged picture, that nobody else is shown would be no finding."""
    monkeypatch.setattr(post_stage, "worst_foreign_share", lambda *_: (0.0, 0))
    assert look(house, tmp_path / "three") == []
    house.pictures["patient-a"] = [IN_B_TIME]  # in the fourth experiment both are there then
    together = {"patient A's pictures show nobody else", "patient B's pictures show nobody else"}
    assert together <= set(look(house, tmp_path / "four", number=4))


def test_a_picture_that_nobody_can_open_is_told(house: WalletsStandIn, tmp_path: Path) -> None:
    assert look(house, tmp_path, kept=3) == ["the wallets together open every picture that the robot kept"]


def test_a_stranger_who_is_served_is_told(house: WalletsStandIn, tmp_path: Path) -> None:
    house.refusals = {"custodian-1": "NOT_PERMITTED", "custodian-2": "OK"}
    assert look(house, tmp_path) == ["patient B gets no frame of patient A", "patient A gets no frame of patient B"]
    house.refusals, house.view_refusal = {"custodian-1": "NOT_PERMITTED"}, ""
    assert len(look(house, tmp_path / "again")) == 2


def test_whoever_was_not_in_the_scene_must_have_nothing(house: WalletsStandIn, tmp_path: Path) -> None:
    house.pictures["patient-z"] = []
    checks = CheckList(listener=lambda check: None)
    stage = PostStage(cast(Stage, house), EXPERIMENTS[2].load_scene(), tmp_path, checks, lambda line: None)
    asyncio.run(stage.look(("patient-z",), 0))
    assert checks.ok
    house.pictures["patient-z"] = [1]
    asyncio.run(stage.look(("patient-z",), 0))
    assert [check.name for check in checks.checks if not check.ok] == [
        "patient Z, whom the robot never met, has nothing"
    ]


def test_a_change_in_every_custodians_store_must_be_found_and_named(house: WalletsStandIn, tmp_path: Path) -> None:
    assert look(house, tmp_path, corrupt=True) == ["corruption off-chain is detected, and the frame named"]
    assert house.changed == [("node-1", 0), ("node-2", 0)]
    house.status["patient-a/0"] = "corrupted"
    house.pictures["patient-a"] = [IN_A_TIME]
    failed = look(house, tmp_path / "again", corrupt=True)
    assert failed == ["patient A opens and verifies them"]  # here it was corrupt from the beginning


def test_an_alarm_about_what_nobody_touched_is_told(house: WalletsStandIn, tmp_path: Path) -> None:
    house.status["patient-b/0"] = "corrupted"
    assert look(house, tmp_path) == ["patient B opens and verifies them", "nothing untouched is called corrupted"]
