"""A wallet made again: with words alone, with former ones beside them, and with files that were mixed up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from tests.world.stolen import OLD_WORDS, WalletHarness


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WalletHarness:
    """A person who has changed her words, and has the old ones in a file."""
    desk = WalletHarness(tmp_path, monkeypatch)
    (tmp_path / "old.txt").write_text(OLD_WORDS + "\n")
    assert desk.rotate().exit_code == 0
    return desk


def restore(desk: WalletHarness, profile: str, words: str, *former: str) -> tuple[int, str]:
    named = [part for each in former for part in ("--former", str(desk.folder / each))]
    command = ("restore", "--words-file", str(desk.folder / words), "--fast-passphrase", "--json")
    done = desk.run(*command, *named, profile=profile)
    answer = json.loads(done.stdout)
    return done.exit_code, answer["error"]["code"] if "error" in answer else str(answer["words_checked"])


def test_with_the_new_words_alone_it_says_which_words_are_missing_and_not_to_ask_the_hospital(
    desk: WalletHarness,
) -> None:
    assert restore(desk, "alone", "new.txt") == (0, "False")
    for command in ("records", "inbox"):
        said = " ".join(desk.run(command, profile="alone").output.split())
        assert "2 records of before you changed your words" in said
        assert "restore --words-file NEW --former OLD" in said
        assert "Ask" not in said
    (visit,) = json.loads(desk.run("records", "--json", profile="alone").stdout)["visits"]
    assert visit["needs_former_words"] is True


def test_records_that_a_robot_sealed_wrongly_are_a_matter_for_the_hospital(desk: WalletHarness) -> None:
    story = desk.story
    story.hospital.record(story.visit(7, person=story.person), sealed_metadata=bytes(560))
    said = " ".join(desk.run("records").output.split())
    assert "1 record cannot be opened with your keys. Ask the hospital why." in said
    assert "--former" not in said


def test_both_files_are_checked_against_who_is_a_member(desk: WalletHarness) -> None:
    assert restore(desk, "both", "new.txt", "old.txt") == (0, "True")
    assert json.loads(desk.run("records", "--json", profile="both").stdout)["visits"][0]["needs_former_words"] is False


def test_files_the_wrong_way_round_are_refused_and_leave_no_wallet(desk: WalletHarness) -> None:
    assert restore(desk, "swapped", "old.txt", "new.txt") == (1, "WORDS_SWAPPED")
    assert not (desk.folder / "swapped.wallet").exists()
    command = ("restore", "--words-file", str(desk.folder / "old.txt"), "--former", str(desk.words_file))
    assert "the other way round" in desk.run(*command, "--fast-passphrase", profile="swapped").output


def test_the_same_words_twice_are_refused(desk: WalletHarness) -> None:
    (desk.folder / "loud.txt").write_text(OLD_WORDS.upper())
    assert restore(desk, "twice", "new.txt", "new.txt") == (2, "WORDS_REPEATED")
    assert restore(desk, "twice", "new.txt", "old.txt", "loud.txt") == (2, "WORDS_REPEATED")
    assert not (desk.folder / "twice.wallet").exists()


def test_without_a_network_it_is_made_all_the_same_and_found_out_later(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def away(*_: object) -> None:
        raise BlockRobotError("NODE_UNREACHABLE")

    with monkeypatch.context() as cut:
        cut.setattr(desk.story.chain, "state_values", away)
        assert restore(desk, "swapped", "old.txt", "new.txt") == (0, "False")
    assert Keystore.open(desk.folder / "swapped.wallet", "tea and lemon cake").content.words == OLD_WORDS
    refused = desk.run("records", "--json", profile="swapped")
    assert json.loads(refused.stdout)["error"]["code"] == "WORDS_SWAPPED"
