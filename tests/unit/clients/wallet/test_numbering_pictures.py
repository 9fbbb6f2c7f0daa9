"""A picture has one number, from 1, wherever a person or a program reads it, and that is the one to erase it by."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.wallet.commands import records_command, view_commands
from tests.miscounting_robot import miscounting
from tests.unit.clients.wallet.test_sharing_commands import NAMES, People


def test_the_picture_that_is_erased_is_the_one_that_has_this_number_wherever_she_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers count from 1: in what `verify` says, in both commands' JSON, and in what `erase --frames` takes."""
    people = People(tmp_path, monkeypatch)
    for module, command in ((view_commands, view_commands.verify), (records_command, records_command.records)):
        monkeypatch.setattr(module, "run_with_wallet", people._run_opened)
        monkeypatch.setitem(NAMES, str(command.name), command)
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
    written: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    people = People(tmp_path, monkeypatch)
    _, (record_id,) = people.ward.record_visit(1)
    height = people.ward.chain.height
    refused = people.run(people.ward.wallet, "erase", record_id.hex(), "--frames", written, "--yes")
    assert (refused.exit_code, "counted from 1" in refused.output) == (2, True)
    assert people.ward.chain.height == height, "nothing was asked for"


def test_each_picture_that_a_robot_committed_to_and_did_not_count_is_erased_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    people = People(tmp_path, monkeypatch)
    miscounting(monkeypatch, 1)
    _, (record_id,) = people.ward.record_visit(1)
    beyond = people.run(people.ward.wallet, "erase", record_id.hex(), "--frames", "3", "--yes")
    assert (beyond.exit_code, "There is no picture 3: they are 1 to 2." in beyond.output) == (2, True)
    (asked,) = people.told(people.ward.wallet, "erase", record_id.hex(), "--frames", "2", "--yes")["erasures"]
    assert people.ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"] == [1]
