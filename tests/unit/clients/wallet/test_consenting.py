"""A wallet's say, against the contract itself: what is signed, what is read back, and that no is as easy as yes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clients.sdk.chain.receipts import FinalReceipt
from clients.wallet.cli import main
from clients.wallet.commands import consent_commands
from clients.wallet.commands.consent_commands import consent
from clients.wallet.consent.consent_choices import ConsentClient, round_period
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from consensus.errors import BlockRobotError
from consensus.limits import TIME_BUCKET_MS
from consensus.rights.sensors import SENSORS, require_sensor
from tests.world.commands import open_for_commands
from tests.world.notices import NoticeWard
from tests.world.transcripts import Transcript


class ConsentHarness:
    """A ward, and a wallet that was registered without consenting to anything."""

    def __init__(self, folder: Path) -> None:
        ward = NoticeWard(folder)
        self.hospital, self.wallet = ward.chain, ward.come_in("bea", purposes=())

    @property
    def consenting(self) -> ConsentClient:
        return ConsentClient(self.wallet)

    async def rows(self) -> dict[tuple[str, str], tuple[bool, str]]:
        return {
            (row.purpose, row.sensor): (row.holds, row.last.status) for row in (await self.consenting.choices()).rows
        }


@pytest.fixture
def house(tmp_path: Path) -> ConsentHarness:
    return ConsentHarness(tmp_path)


@pytest.fixture
def run(house: ConsentHarness, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Run `wallet consent ...` on that wallet."""

    open_for_commands(monkeypatch, lambda: house.wallet)
    monkeypatch.setattr(consent_commands.time, "time", lambda: house.hospital.time_ms / 1000)
    return lambda *arguments: CliRunner().invoke(main.wallet, ["consent", *arguments])


async def test_what_is_given_holds_from_the_height_that_the_wallet_names(house: ConsentHarness) -> None:
    word = await house.consenting.give(["care"], ["depth", "rgb"])
    assert (word.height, word.from_height) == (house.hospital.height, house.hospital.height + 1)
    assert await house.rows() == {("care", "depth"): (False, "given"), ("care", "rgb"): (False, "given")}
    house.hospital.block([])
    assert await house.rows() == {("care", "depth"): (True, "given"), ("care", "rgb"): (True, "given")}


async def test_taking_back_needs_no_word_of_what_was_given(house: ConsentHarness) -> None:
    await house.consenting.give(["care", "research"], ["depth", "audio"], until_ms=house.hospital.time_ms + 10**9)
    await house.consenting.withdraw([], [])
    assert set((await house.rows()).values()) == {(False, "withdrawn")}


async def test_a_wallet_that_was_restored_can_take_back_too(house: ConsentHarness) -> None:
    await house.consenting.give(["care"], ["depth"])
    house.wallet.store.content.handle = b""
    await house.consenting.withdraw([], [])
    assert await house.rows() == {("care", "depth"): (False, "withdrawn")}


async def test_a_wrong_code_is_refused_before_anything_is_signed(house: ConsentHarness) -> None:
    height = house.hospital.height
    for purposes, sensors, code in (
        (["world-domination"], ["depth"], "PURPOSE_UNKNOWN"),
        (["care"], ["x-ray"], "SENSOR_UNKNOWN"),
    ):
        with pytest.raises(BlockRobotError, match=code):
            await house.consenting.give(purposes, sensors)
        with pytest.raises(BlockRobotError, match=code):
            await house.consenting.refuse(purposes, sensors)
    assert house.hospital.height == height


def test_a_period_is_rounded_so_that_it_is_never_longer_than_asked_for() -> None:
    assert round_period(1, 2 * TIME_BUCKET_MS - 1) == (TIME_BUCKET_MS, TIME_BUCKET_MS)
    assert round_period(0, 0) == (0, 0)
    assert round_period(TIME_BUCKET_MS, TIME_BUCKET_MS) == (TIME_BUCKET_MS, TIME_BUCKET_MS)


def test_every_sensor_has_a_sentence() -> None:
    assert all(require_sensor(code).endswith(".") for code in SENSORS)


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_commands_tell_a_story_in_plain_words(
    house: ConsentHarness,
    run: Callable[..., Any],
    transcript: Transcript,
    monkeypatch: pytest.MonkeyPatch,
    language: str,
) -> None:
    """Among others: without a yes to depth, which tells people apart, nothing is kept of one to other sensors."""
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    say = transcript.follow(run, "bea")
    say("withdraw")
    say("give", "--purpose", "care", "--sensor", "rgb", "--sensor", "audio")
    house.hospital.block([])
    say("list", "--purpose", "care", "--sensor", "rgb")
    say("give", "--purpose", "care", "--until", "+30d")
    house.hospital.block([])
    say("list")
    say("withdraw")
    say("list")
    say("refuse", "--purpose", "research")
    for filtered in (("--purpose", "teaching"), ("--sensor", "x"), ("--purpose", "x")):
        say("list", *filtered)
    transcript.compare(f"consent.{language}")


def test_a_program_gets_one_object_and_an_exit_code(house: ConsentHarness, run: Callable[..., Any]) -> None:
    given = json.loads(run("give", "--purpose", "care", "--sensor", "rgb", "--height", "500", "--json").output)
    assert (given["ok"], given["from_height"], given["sensors"], given["status"]) == (True, 500, ["rgb"], "given")
    listed = json.loads(run("list", "--json").output)
    assert listed["choices"] == [
        {
            "purpose": "care",
            "sensor": "rgb",
            "holds_now": False,
            "status": "given",
            "from_height": 500,
            "since_ms": house.hospital.time_ms,
            "period_from_ms": None,
            "period_until_ms": None,
            "mandate_id": None,
        }
    ]
    for count in (1, 0):
        taken = json.loads(run("withdraw", "--json").output)
        assert (taken["status"], taken["count"]) == ("withdrawn", count)
    wrong = run("give", "--purpose", "care", "--height", "1", "--json")
    assert (wrong.exit_code, json.loads(wrong.output)["error"]["code"]) == (4, "CALL_REFUSED")
    assert "HEIGHT_WRONG" in wrong.output


async def test_a_giving_names_what_the_wallet_knew_so_it_cannot_come_after_a_later_no(house: ConsentHarness) -> None:
    """She gives, it is not final in time; she takes back what is not there yet; then the giving comes after all."""
    held_back: list[tuple[Any, ...]] = []

    class LostError(Exception):
        pass

    async def lose(*arguments: Any) -> FinalReceipt:
        held_back.append(arguments)
        raise LostError

    house.wallet.network.call = lose  # type: ignore[method-assign, assignment]
    with pytest.raises(LostError):
        await house.consenting.give(["care"], ["depth"])
    del house.wallet.network.call
    assert (await house.consenting.withdraw([], [])).count == 0
    key, contract, entry, arguments = held_back[0]
    assert house.hospital.send(key, contract, entry, *arguments).code == "WORD_OLDER"
    assert await house.rows() == {}
    await house.consenting.give(["care"], ["depth"])
    house.hospital.block([])
    assert await house.rows() == {("care", "depth"): (True, "given")}


@pytest.mark.parametrize(
    "arguments",
    [
        ["give"],
        ["refuse"],
        ["give", "--purpose", "care", "--until", "yesterday"],
        ["give", "--purpose", "care", "--until", "2001-01-01"],
        ["give", "--purpose", "care", "--from", "+2d", "--until", "+1d"],
        ["give", "--purpose", "care", "--height", "-1"],
    ],
)
def test_wrong_usage_is_told_and_nothing_is_signed(
    house: ConsentHarness, run: Callable[..., Any], arguments: list[str]
) -> None:
    height = house.hospital.height
    assert run(*arguments).exit_code == 2
    assert house.hospital.height == height


def test_withdrawing_is_as_easy_as_giving() -> None:
    """No more options are needed, and there is no question in between that giving does not ask."""
    giving, withdrawing = (consent.commands[name] for name in ("give", "withdraw"))
    names = [{option.name for option in command.params} for command in (giving, withdrawing)]
    assert names[1] < names[0]
    assert not any(option.required for option in withdrawing.params)
    assert not any(getattr(option, "prompt", None) for option in withdrawing.params)
