"""Erasing on the command line: she is asked about what is meant, by its number, and nothing is erased twice."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from clients.wallet.ledger.visit_audit import audit_visit
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from tests.miscounting_robot import miscounting
from tests.world.commands import People, sit_at_terminal
from tests.world.transcripts import Transcript


class AtTerminal(People):
    """The same people, at a terminal where a question is answered."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(folder, monkeypatch)
        sit_at_terminal(monkeypatch)

    def erase(self, record_id: bytes, *more: str, answer: str = "n") -> Result:
        """Type `erase` and answer its question."""
        return self.run(self.ward.wallet, "erase", record_id.hex(), *more, typed=f"{answer}\n")

    def erasures_of(self, record_id: bytes, *more: str) -> Any:
        """Erase without a question, and return what a program is told."""
        return self.told(self.ward.wallet, "erase", record_id.hex(), "--yes", *more)

    def asked_for(self) -> list[list[int]]:
        """Return the pictures (indexes) of each erasure that stands in the trail of her only visit, in order."""

        async def read() -> list[list[int]]:
            trail = await audit_visit(self.ward.wallet, await self.ward.known_visit())
            return [entry.data["frames"] for entry in trail if entry.kind == "erasure_requested"]

        return asyncio.run(read())

    def confirm_all(self, told: Any) -> None:
        """Let every custodian confirm what was asked for."""
        for erasure in told["erasures"]:
            self.ward.chain.receipts_of_all(bytes.fromhex(erasure["erasure_id"]))


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AtTerminal:
    return AtTerminal(tmp_path, monkeypatch)


@pytest.mark.parametrize("language", LANGUAGES)
def test_she_is_told_what_goes_what_remains_and_who_has_received_it_before_she_is_asked(
    people: AtTerminal, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    ward, ann = people.ward, people.ward.wallet
    say = transcript.follow(lambda *typed, **more: people.run(ann, *typed, **more), "ann")
    visit, (first, second) = ward.record_visit(2)
    name, handle = first.hex(), people.doctor.store.content.handle.hex()
    say("erase", "--all", typed="n\n")
    for numbers in ("2", "2,1", "1,6"):
        say("erase", name, "--frames", numbers, typed="n\n")
    say("erase", name, "--frames", "6,7", "--yes")
    assert people.asked_for() == [], "it was looked at, to count what the robot may not have counted"
    people.confirm_all(people.erasures_of(first, "--frames", "1"))
    say("erase", name, "--frames", "1", typed="y\n")
    say("erase", "--all", typed="n\n")
    say("share", "--visit", visit.owner.hex(), "--with", handle, "--purpose", "care", "--for", "7d", typed="n\n")
    say("erase", name, "--frames", "1,2", typed="y\n")
    assert people.asked_for() == [[0], [1]]
    people.share(second, "--yes")

    async def look() -> None:
        receiving = ward.receiving(people.doctor)
        (receipt,) = await receiving.inbox()
        await receiving.look(receipt, second, await receiving.request_access(receipt, [second]))

    asyncio.run(look())
    say("erase", second.hex(), "--frames", "1", typed="n\n")
    say("erase", second.hex(), typed="y\n")
    transcript.compare(f"erasing.{language}")


def test_what_is_erased_already_is_left_out_and_no_second_erasure_is_written(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    people.confirm_all(people.erasures_of(record_id, "--frames", "1"))
    height = people.ward.chain.height
    told = people.erasures_of(record_id, "--frames", "1")
    assert (told["erasures"], told["left_out_numbers"]) == ([], [1])
    assert people.ward.chain.height == height


def test_a_picture_whose_erasure_is_asked_for_and_not_confirmed_is_not_asked_for_again(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    assert people.erasures_of(record_id, "--frames", "1")["left_out_numbers"] == []
    height = people.ward.chain.height
    assert people.erasures_of(record_id, "--frames", "1")["left_out_numbers"] == [1]
    assert people.ward.chain.height == height
    (asked,) = people.erasures_of(record_id, "--frames", "1,2")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [1]


@pytest.mark.parametrize("written", ["1,,2", "1,", "+1", "01", "１", "1_0", "1-2", "1 2", "1;2", "9" * 5000])
def test_only_plain_numbers_name_pictures_and_the_refusal_says_that_there_are_no_ranges(
    written: str, people: AtTerminal
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    refused = people.erase(record_id, "--frames", written, "--yes")
    assert refused.exit_code == 2
    assert "There are no ranges: for 1 to 3 write 1,2,3." in " ".join(refused.output.split())


def test_blanks_behind_commas_and_a_number_that_is_named_twice_do_no_harm(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    (asked,) = people.erasures_of(record_id, "--frames", "2, 1,2")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [0, 1]


def test_the_picture_that_is_erased_is_the_one_that_has_this_number_wherever_she_reads_it(
    people: AtTerminal,
) -> None:
    """Numbers count from 1: in what `verify` says, in both commands' JSON, and in what `erase --frames` takes."""
    _, (record_id,) = people.ward.record_visit(1)
    wallet = people.ward.wallet

    def pictures() -> list[tuple[int, str]]:
        (told,) = people.told(wallet, "verify", record_id.hex())["records"]
        return [(frame["number"], frame["status"]) for frame in told["frames"]]

    assert pictures() == [(1, "ok"), (2, "ok")]
    none = people.run(wallet, "erase", record_id.hex(), "--frames", "0", "--yes")
    assert (none.exit_code, "counted from 1" in none.output) == (2, True)
    beyond = people.run(wallet, "erase", record_id.hex(), "--frames", "3", "--yes")
    assert (beyond.exit_code, "There is no picture 3: they are 1 to 2." in beyond.output) == (2, True)
    assert pictures() == [(1, "ok"), (2, "ok")]
    (asked,) = people.told(wallet, "erase", record_id.hex(), "--frames", "2", "--yes")["erasures"]
    people.ward.chain.receipts_of_all(bytes.fromhex(asked["erasure_id"]))
    (visit,) = people.told(wallet, "records")["visits"]
    assert visit["records"][0]["erased_numbers"] == [2]


@pytest.mark.parametrize("written", ["", ",", " , ", "0", "1,-1", "one"])
def test_frames_that_name_no_picture_erase_nothing_rather_than_the_whole_record(
    written: str, people: AtTerminal
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    height = people.ward.chain.height
    refused = people.run(people.ward.wallet, "erase", record_id.hex(), "--frames", written, "--yes")
    assert (refused.exit_code, "counted from 1" in refused.output) == (2, True)
    assert people.ward.chain.height == height, "nothing was asked for"


def test_each_picture_that_a_robot_committed_to_and_did_not_count_is_erased_alone(
    people: AtTerminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    miscounting(monkeypatch, 1)
    _, (record_id,) = people.ward.record_visit(1)
    beyond = people.run(people.ward.wallet, "erase", record_id.hex(), "--frames", "3", "--yes")
    assert (beyond.exit_code, "There is no picture 3: they are 1 to 2." in beyond.output) == (2, True)
    (asked,) = people.told(people.ward.wallet, "erase", record_id.hex(), "--frames", "2", "--yes")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [1]


@pytest.mark.parametrize("command", ["view", "verify", "erase", "share"])
def test_who_names_an_erased_record_is_told_when_they_erased_it(people: AtTerminal, command: str) -> None:
    _, (first, _) = people.ward.record_visit(2)
    people.confirm_all(people.erasures_of(first))
    more = {"share": ["--with", people.doctor.store.content.handle.hex(), "--purpose", "care", "--for", "7d", "--yes"]}
    said = people.run(people.ward.wallet, command, first.hex()[:12], *more.get(command, []))
    assert (said.exit_code != 0, "CLIP_ERASED" in said.output) == (True, True), said.output
    assert f"You erased {first.hex()[:12]} (" in said.output
