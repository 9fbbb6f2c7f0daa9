"""`wallet rotate`, `transfer`, `leave` and `restore --former` as people run them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from clients.wallet import opening, rotating_commands
from clients.wallet.cli import wallet
from clients.wallet.keystore import Keystore
from clients.wallet.wallet import Wallet
from tests.unit.clients.wallet.stolen import Story

OLD_WORDS = " ".join(["abandon"] * 23 + ["art"])


class Desk:
    """A person at her device: commands run on the story's wallet and chain."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.story = Story(folder, OLD_WORDS)
        self.story.visit(1)
        self.folder = folder
        self.words_file = folder / "new.txt"
        passphrase = folder / "passphrase"
        passphrase.write_text("tea\n")
        monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(passphrase))
        monkeypatch.setattr(opening, "load_genesis", lambda _: self.story.hospital.genesis)
        monkeypatch.setattr(opening, "Wallet", self._open)

    def _open(self, store: Keystore, genesis: Any) -> Wallet:
        opened = Wallet(store, genesis)
        opened.network = self.story.chain  # type: ignore[assignment]
        return opened

    def run(self, *arguments: str, profile: str = "ann", keyboard: str | None = None) -> Result:
        group = ["--wallet-dir", str(self.folder), "--profile", profile]
        return CliRunner().invoke(wallet, [*group, *arguments], input=keyboard)

    def rotate(self, *arguments: str) -> Result:
        return self.run("rotate", "--words-file", str(self.words_file), "--yes", "--now", *arguments)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(tmp_path, monkeypatch)


def test_rotating_tells_what_was_done_and_what_to_keep(desk: Desk) -> None:
    done = desk.rotate()
    assert done.exit_code == 0, done.output
    assert "1 visits have a key of your present words" in done.output
    assert "Keep the old ones too" in done.output
    assert desk.words_file.read_text().strip() == Keystore.open(desk.story.path, "tea").content.words
    assert desk.words_file.stat().st_mode & 0o777 == 0o600
    assert OLD_WORDS not in done.output


def test_a_program_gets_one_object(desk: Desk) -> None:
    done = desk.rotate("--json")
    answer = json.loads(done.stdout)
    assert (answer["ok"], len(answer["transferred"]), answer["taken_visits"]) == (True, 1, [])
    late = desk.story.visit(2)
    told = json.loads(desk.run("records", "--json").stdout)
    assert told["exposed_visits"] == [late.owner.hex()]
    said = desk.run("records")
    assert "1 visits still obey your former words. Run: blockrobot wallet transfer" in " ".join(said.output.split())
    moved = json.loads(desk.run("transfer", "--now", "--json").stdout)
    assert moved["transferred"] == [late.owner.hex()]
    assert json.loads(desk.run("records", "--json").stdout)["exposed_visits"] == []


def test_without_a_terminal_words_go_to_a_file_and_nothing_begins_without_one(desk: Desk) -> None:
    refused = desk.run("rotate", "--yes")
    assert refused.exit_code == 2
    assert "--words-file" in refused.output
    assert desk.story.chain.calls == []
    assert desk.run("rotate", "--words-file", str(desk.words_file)).exit_code == 2
    assert not desk.words_file.exists()
    assert Keystore.open(desk.story.path, "tea").content.next_words == ""


def test_a_file_that_is_there_already_is_not_written_over(desk: Desk) -> None:
    desk.words_file.write_text("a letter\n")
    assert desk.rotate().exit_code == 2
    assert desk.words_file.read_text() == "a letter\n"
    assert desk.story.chain.calls == []
    desk.words_file.unlink()
    assert desk.rotate().exit_code == 0
    assert desk.story.open().store.content.former == [OLD_WORDS]


def test_at_a_terminal_the_words_are_asked_back(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["zero", "one", "two"]
    monkeypatch.setattr(rotating_commands.secrets, "randbelow", lambda _: 1)
    answers = iter(["zero", " One "])
    monkeypatch.setattr(click, "prompt", lambda *_, **__: next(answers))
    rotating_commands._show_words(" ".join(words), None)
    assert list(answers) == []


def test_restoring_takes_former_words_too(desk: Desk) -> None:
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


def test_leaving_says_what_stays_and_asks(desk: Desk) -> None:
    asked = desk.run("leave")
    assert asked.exit_code == 2
    assert "What was recorded stays until it expires" in asked.output
    assert desk.story.chain.calls == []
    gone = json.loads(desk.run("leave", "--yes", "--json").stdout)
    assert gone == {"ok": True, "height": desk.story.hospital.height}
    assert json.loads(desk.run("leave", "--yes", "--json").stdout) == {"ok": True, "height": None}
    assert len(json.loads(desk.run("records", "--json").stdout)["visits"]) == 1
