"""`wallet rotate`, `transfer`, `leave` and `restore --former` as people run them."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from clients.wallet.cli import wallet_context
from clients.wallet.commands.account import rotate_commands
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys
from consensus.errors import BlockRobotError
from tests.world.stolen import OLD_WORDS, WalletHarness, give_grant, take_new_words
from tests.world.transcripts import Transcript
from tests.world.ward import Patient


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WalletHarness:
    return WalletHarness(tmp_path, monkeypatch)


@pytest.mark.parametrize("language", LANGUAGES)
def test_words_are_changed_visits_moved_and_a_membership_ended_in_each_language(
    desk: WalletHarness, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    say = transcript.follow(desk.run, "ann")
    say("rotate", "--words-file", str(desk.words_file), "--yes", "--now")
    for number in (2, 3):
        desk.story.visit(number)
    say("records")
    say("transfer", "--now")
    say("leave")
    for _ in range(2):
        say("leave", "--yes")
    transcript.compare(f"new-words.{language}")


@pytest.mark.parametrize("language", LANGUAGES)
def test_who_was_too_late_is_warned_in_each_language(
    desk: WalletHarness, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    say = transcript.follow(desk.run, "ann")
    say("records")
    asyncio.run(take_new_words(desk.story.copy("thief", OLD_WORDS, [])))
    say("records")
    say("rotate", "--words-file", str(desk.words_file), "--yes", "--now")
    transcript.compare(f"too-late.{language}")


def test_rotating_tells_what_was_done_and_what_to_keep(desk: WalletHarness) -> None:
    done = desk.rotate()
    assert done.exit_code == 0, done.output
    assert desk.words_file.read_text().strip() == Keystore.open(desk.story.path, "tea and lemon cake").content.words
    assert desk.words_file.stat().st_mode & 0o777 == 0o600
    assert OLD_WORDS not in done.output


def test_a_program_gets_one_object(desk: WalletHarness) -> None:
    done = desk.rotate("--json")
    answer = json.loads(done.stdout)
    assert (answer["ok"], len(answer["transferred"]), answer["taken_visits"]) == (True, 1, [])
    late = desk.story.visit(2)
    told = json.loads(desk.run("records", "--json").stdout)
    assert told["exposed_visits"] == [late.owner.hex()]
    said = desk.run("records")
    assert f"1 visit still obeys your former words. Run: {desk.command} transfer" in " ".join(said.output.split())
    moved = json.loads(desk.run("transfer", "--now", "--json").stdout)
    assert moved["transferred"] == [late.owner.hex()]
    assert json.loads(desk.run("records", "--json").stdout)["exposed_visits"] == []


@pytest.mark.parametrize("keep", [(), ("--keep-shares",)])
def test_what_others_shared_with_the_old_words_ends_and_is_told(desk: WalletHarness, keep: tuple[str, ...]) -> None:
    story = desk.story
    visit = story.visit(3)
    his = give_grant(story, visit.key, visit, "his")
    answer = json.loads(desk.rotate("--json", *keep).stdout)
    assert answer["ended_shares"] == ([] if keep else [his.hex()])
    late = story.visit(2)
    give_grant(story, late.key, late, "late")
    said = desk.run("transfer", "--now", *keep).output
    assert "1 visit has a key" in said
    assert ("1 share that this wallet did not make was ended." in said) == (not keep)


def test_without_a_terminal_words_go_to_a_file_and_nothing_begins_without_one(desk: WalletHarness) -> None:
    refused = desk.run("rotate", "--yes")
    assert refused.exit_code == 2
    assert "--words-file" in refused.output
    assert desk.story.chain.calls == []
    assert desk.run("rotate", "--words-file", str(desk.words_file)).exit_code == 2
    assert not desk.words_file.exists()
    assert Keystore.open(desk.story.path, "tea and lemon cake").content.next_words == ""


def test_a_file_that_is_there_already_is_not_written_over(desk: WalletHarness) -> None:
    desk.words_file.write_text("a letter\n")
    assert desk.rotate().exit_code == 2
    assert desk.words_file.read_text() == "a letter\n"
    assert desk.story.chain.calls == []
    desk.words_file.unlink()
    assert desk.rotate().exit_code == 0
    assert desk.story.open().store.content.former == [OLD_WORDS]


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def stopped(desk: WalletHarness, *arguments: str) -> str:
    done = desk.rotate(*arguments)
    assert done.exit_code == 1, done.output
    assert "Aborted" not in done.output
    (told,) = [line for line in done.stderr.split("\n") if line.startswith("Stopped")]
    return told


def test_who_says_no_or_ctrl_c_at_the_question_is_told_that_nothing_changed(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rotate_commands, "confirm_or_print", interrupt)
    told = stopped(desk)
    assert told.startswith("Stopped. Nothing is changed: your present words are in force.")
    assert told.endswith(f"To begin again: {desk.command} rotate")
    assert desk.story.chain.calls == []
    assert desk.story.open().store.content.next_words == ""


def test_ctrl_c_while_the_new_words_are_handed_over_says_that_they_wait(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rotate_commands, "write_words", interrupt)
    told = stopped(desk)
    assert f"The next `{desk.command} rotate` shows the same new words again" in told
    waiting = desk.story.open().store.content.next_words
    monkeypatch.undo()
    assert (desk.story.chain.calls, len(waiting.split())) == ([], 24)


def test_ctrl_c_while_the_change_is_sent_says_that_nobody_knows_and_that_both_are_to_be_kept(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as cut:
        cut.setattr(KeyRotation, "_say_rotation", interrupt)
        told = stopped(desk)
    assert "Whether your new words are in force already is not known: keep both" in told
    assert told.endswith(f"{desk.command} rotate")
    assert desk.rotate().exit_code == 0
    assert desk.story.open().store.content.former == [OLD_WORDS]


def test_ctrl_c_before_the_wallet_is_open_says_nothing_of_words_that_may_be_in_force_already(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as cut:
        cut.setattr(KeyRotation, "_say_rotation", interrupt)
        stopped(desk)
    with monkeypatch.context() as cut:
        cut.setattr(wallet_context, "read_passphrase", interrupt)
        told = stopped(desk)
    assert told == f"Stopped. Nothing was done by this command. Run it again: {desk.command} rotate"


def test_ctrl_c_between_visits_says_what_is_done_and_how_many_still_obey_the_old_words(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.story.visit(2)
    transfer, moved = KeyRotation.transfer, list[object]()

    async def only_once(self: KeyRotation, visit: Any) -> None:
        if moved:
            raise KeyboardInterrupt
        moved.append(visit)
        await transfer(self, visit)

    with monkeypatch.context() as cut:
        cut.setattr(KeyRotation, "transfer", only_once)
        told = stopped(desk)
        assert told.startswith("Stopped. Your new words are in force; keep the old ones too. 1 visit still obeys")
        assert told.endswith(f"To go on: {desk.command} rotate")
        assert stopped(desk) == told, "also when it had gone on"
    done = desk.rotate()
    assert (done.exit_code, "1 visit has a key" in done.output) == (0, True), done.output


def test_ctrl_c_when_all_was_done_says_so(desk: WalletHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wallet_context, "print_failed_nodes", interrupt)
    told = stopped(desk)
    assert told.startswith("Stopped, when all was done: your new words are in force")
    assert told.endswith(f"Next: {desk.command} records")


def test_restoring_takes_former_words_too(desk: WalletHarness) -> None:
    desk.rotate()
    former = desk.folder / "old.txt"
    former.write_text(OLD_WORDS.upper())
    command = ("restore", "--words-file", str(desk.words_file), "--fast-passphrase", "--json")
    assert desk.run(*command, "--former", str(former), profile="both").exit_code == 0
    both = json.loads(desk.run("records", "--json", profile="both").stdout)
    assert [len(visit["records"]) for visit in both["visits"]] == [2]
    assert desk.run(*command, profile="alone").exit_code == 0
    alone = json.loads(desk.run("records", "--json", profile="alone").stdout)
    assert [len(visit["unreadable_records"]) for visit in alone["visits"]] == [2]
    former.write_text("these are no words")
    wrong = desk.run(*command, "--former", str(former), profile="wrong")
    assert wrong.exit_code == 1
    assert json.loads(wrong.stdout)["error"]["code"] == "WORDS_INVALID"
    assert not (desk.folder / "wrong.wallet").exists()


def test_leaving_says_what_stays_and_asks(desk: WalletHarness) -> None:
    assert desk.run("leave").exit_code == 2
    assert desk.story.chain.calls == []
    gone = json.loads(desk.run("leave", "--yes", "--json").stdout)
    assert gone == {"ok": True, "height": desk.story.hospital.height}
    assert json.loads(desk.run("leave", "--yes", "--json").stdout) == {"ok": True, "height": None}
    assert len(json.loads(desk.run("records", "--json").stdout)["visits"]) == 1


def test_who_was_too_late_is_warned_loudly_and_still_sees(desk: WalletHarness) -> None:
    """Each command that opens the wallet says so; a program's object stays one object."""
    assert desk.run("records").exit_code == 0
    asyncio.run(take_new_words(desk.story.copy("thief", OLD_WORDS, [])))
    done = desk.run("records", "--json")
    assert len(json.loads(done.stdout)["visits"]) == 1
    assert "make nobody a member any more" in done.stderr
    assert "when-your-wallet-is-stolen" in done.stderr
    refused = desk.rotate()
    assert refused.exit_code == 4
    assert "registrar's desk" in " ".join(refused.output.split())
    assert desk.story.open().store.content.next_words == ""
    left = desk.run("leave", "--yes", "--json")
    assert (left.exit_code, json.loads(left.stdout)["error"]["code"]) == (4, "MEMBERSHIP_ENDED")


def test_the_way_for_who_was_too_late_as_it_is_written_down(desk: WalletHarness) -> None:
    """New words, the former ones beside them, a new card, and what the thief has not moved is out of his reach."""
    (name,) = [each["visit"] for each in json.loads(desk.run("records", "--json").stdout)["visits"]]
    asyncio.run(take_new_words(desk.story.copy("thief", OLD_WORDS, [])))
    former, words = desk.folder / "old.txt", str(desk.words_file)
    former.write_text(OLD_WORDS)
    assert desk.run("new", "--words-file", words, "--fast-passphrase", profile="draft").exit_code == 0
    restoring = ("restore", "--words-file", words, "--former", str(former), "--fast-passphrase")
    assert desk.run(*restoring, profile="safe").exit_code == 0
    hospital = desk.story.hospital
    person = Patient("again", keys=derive_keys(desk.words_file.read_text().strip()))
    arguments = hospital.register_arguments(person, hospital.card("again"))
    hospital.must(person.identity, "identity", "register", *arguments)
    moved = desk.run("transfer", "--now", "--json", profile="safe")
    assert json.loads(moved.stdout)["transferred"] == [name]
    assert "WARNING" not in moved.stderr
    assert desk.run("records").exit_code == 4


def test_a_visit_that_nobody_can_move_any_more_is_told(desk: WalletHarness) -> None:
    assert desk.rotate().exit_code == 0
    name = json.loads(desk.run("records", "--json").stdout)["visits"][0]["visit"]
    store = desk.story.open().store
    store.content.visits[0].stuck = True
    store.save()
    said = " ".join(desk.run("transfer", "--now").output.split())
    assert "1 visit still obeys your former words, and can be given no other key any more" in said
    told = json.loads(desk.run("records", "--json").stdout)
    assert (told["stuck_visits"], told["exposed_visits"]) == ([name], [])


def test_receipts_that_are_due_are_fetched_before_the_words_change_and_no_longer_after(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One custodian's answer comes, another's does not: rotating waits some seconds at most, and says what is missing."""
    asked: list[tuple[bytes, str]] = []

    async def obtain(self: ConsentReceipts, txid: bytes) -> None:
        content = self._wallet.store.content
        asked.append((txid, content.words))
        if txid == b"2":
            await asyncio.Event().wait()
        content.receipts_due.remove(txid)

    monkeypatch.setattr(ConsentReceipts, "obtain", obtain)
    monkeypatch.setattr(rotate_commands, "RECEIPTS_WAIT_S", 0.01)
    store = desk.story.open().store
    store.content.receipts_due = [b"1", b"2"]
    store.save()
    done = desk.rotate()
    assert done.exit_code == 0, done.output
    assert "1 receipt of consent, still due, cannot be had any more" in done.stderr
    assert asked == [(b"1", OLD_WORDS), (b"2", OLD_WORDS)]
    assert desk.story.open().store.content.receipts_due == []


def test_a_node_that_lied_is_named_and_what_another_proved_is_shown(desk: WalletHarness) -> None:
    desk.story.chain.troubles["node-2"] = BlockRobotError("PROOF_INVALID")
    desk.story.chain.troubles["node-3"] = BlockRobotError("NODE_UNREACHABLE")
    done = desk.run("records")
    assert done.exit_code == 0
    assert "Visit 1" in done.stdout
    assert "node-2 gave an answer that its proof does not bear out (PROOF_INVALID)" in done.stderr
    assert "node-3" not in done.stderr
