"""Erasing on the command line: she is asked about what is meant, by its number, and nothing is erased twice."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from clients.wallet.commands import erase_command
from clients.wallet.ledger.visit_audit import audit_visit
from clients.wallet.present.share_text import explain
from clients.wallet.present.translations import LANGUAGE_VARIABLE
from pages.moments import show_moment
from tests.unit.clients.wallet.test_sharing_commands import People


class AtTerminal(People):
    """The same people, at a terminal where a question is answered."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(folder, monkeypatch)
        monkeypatch.setattr(erase_command, "can_ask", lambda: True)

    def erase(self, record_id: bytes, *more: str, answer: str = "n") -> Result:
        """Type `erase` and answer its question."""
        self.opened = self.ward.wallet
        result = CliRunner().invoke(erase_command.erase, [record_id.hex(), *more], input=f"{answer}\n")
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    def erase_all(self, answer: str = "n") -> Result:
        """Type `erase --all` and answer its question."""
        self.opened = self.ward.wallet
        return CliRunner().invoke(erase_command.erase, ["--all"], input=f"{answer}\n")

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


def flat(output: str) -> str:
    return " ".join(output.split())


def test_the_question_names_the_pictures_by_their_numbers_and_when_the_record_was_made(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    (entry,) = asyncio.run(people.ward.entries())
    first = show_moment(entry.metadata.started_at_ms)
    last = show_moment(entry.metadata.ended_at_ms)
    asked = people.erase(record_id, "--frames", "2")
    assert asked.exit_code == 1
    one = f"Gone will be, for everyone and for ever: picture 2 of 2 in record {record_id.hex()[:12]}"
    assert f"{one}, made from {first} to {last}." in flat(asked.output)
    assert "pictures 1, 2 of 2 in record" in flat(people.erase(record_id, "--frames", "2,1").output)


def test_a_picture_that_is_erased_already_is_named_and_left_out_and_no_second_erasure_is_written(
    people: AtTerminal,
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    people.confirm_all(people.erasures_of(record_id, "--frames", "1"))
    height = people.ward.chain.height
    again = people.erase(record_id, "--frames", "1", answer="y")
    assert again.exit_code == 0, again.output
    assert "Left out, for it is erased already or is being erased: picture 1." in flat(again.output)
    assert "There is nothing left to erase." in again.output
    assert "Gone will be" not in again.output
    told = people.erasures_of(record_id, "--frames", "1")
    assert (told["erasures"], told["left_out_numbers"]) == ([], [1])
    assert people.ward.chain.height == height, "nothing was written"

    both = people.erase(record_id, "--frames", "1,2", answer="y")
    assert "picture 1." in flat(both.output)
    assert "for ever: picture 2 of 2" in flat(both.output)
    assert people.asked_for() == [[0], [1]]


def test_pictures_that_are_gone_already_are_counted_nowhere_among_those_that_are_left(people: AtTerminal) -> None:
    _, (record_id, _) = people.ward.record_visit(2)
    assert "2 records with 4 pictures, of 1 visit." in flat(people.erase_all().output)
    people.confirm_all(people.erasures_of(record_id, "--frames", "1"))
    assert "2 records with 3 pictures, of 1 visit." in flat(people.erase_all().output)
    grantee = asyncio.run(people.ward.grantee(people.doctor))
    shared = explain(asyncio.run(people.ward.entries()), grantee, "care", people.ward.until_ms())
    assert "3 pictures or sounds" in flat(shared)


def test_a_picture_whose_erasure_is_asked_for_and_not_confirmed_is_not_asked_for_again(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    assert people.erasures_of(record_id, "--frames", "1")["left_out_numbers"] == []
    height = people.ward.chain.height
    assert people.erasures_of(record_id, "--frames", "1")["left_out_numbers"] == [1]
    assert people.ward.chain.height == height
    (asked,) = people.erasures_of(record_id, "--frames", "1,2")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [1]


@pytest.mark.parametrize("by_picture", [True, False])
def test_who_has_it_and_that_they_get_nothing_of_it_any_more_is_said_before_she_is_asked(
    people: AtTerminal, by_picture: bool
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    people.share(record_id, "--yes")

    async def look() -> None:
        receiving = people.ward.receiving(people.doctor)
        (receipt,) = await receiving.inbox()
        await receiving.look(receipt, record_id, await receiving.request_access(receipt, [record_id]))

    asyncio.run(look())
    said = flat(people.erase(record_id, *(("--frames", "1") if by_picture else ())).stdout)
    before, _, _ = said.partition("Erase?")
    ends = "its other pictures neither. Share it again if they may go on." if by_picture else "nothing of it any more."
    for part in (ends, "Who has received it before", "Dr Weber (handle ", "who looked ", "What remains"):
        assert part in before


def test_who_was_told_before_the_question_is_not_told_again_after_it(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    people.share(record_id, "--yes")
    said = flat(people.erase(record_id, answer="y").stdout)
    assert said.count("Dr Weber") == 1
    assert "Whether copies were deleted" in said


def test_of_what_was_never_shared_no_sharing_is_told(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    said = flat(people.erase(record_id).stdout)
    assert "Gone will be" in said
    assert "shared" not in said


def test_a_picture_that_is_not_there_is_wrong_usage_and_the_numbers_that_are_there_are_told(
    people: AtTerminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    for more in ((), ("--yes",)):
        refused = people.erase(record_id, "--frames", "1,6", *more)
        assert refused.exit_code == 2
        assert "There is no picture 6: they are 1 to 2." in flat(refused.output)
        for other in ("REQUEST_INVALID", "openapi", "Gone will be"):
            assert other not in refused.output
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    refused = people.erase(record_id, "--frames", "6,7", "--yes")
    assert "Não há imagem 6, 7: vão de 1 a 2." in flat(refused.output)
    assert people.asked_for() == [], "it was looked at, to count what the robot may not have counted"


@pytest.mark.parametrize("written", ["1,,2", "1,", "+1", "01", "１", "1_0", "1-2", "1 2", "1;2", "9" * 5000])
def test_only_plain_numbers_name_pictures_and_the_refusal_says_that_there_are_no_ranges(
    written: str, people: AtTerminal
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    refused = people.erase(record_id, "--frames", written, "--yes")
    assert refused.exit_code == 2
    assert "There are no ranges: for 1 to 3 write 1,2,3." in flat(refused.output)


def test_blanks_behind_commas_and_a_number_that_is_named_twice_do_no_harm(people: AtTerminal) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    (asked,) = people.erasures_of(record_id, "--frames", "2, 1,2")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [0, 1]
