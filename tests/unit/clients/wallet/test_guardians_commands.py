"""`wallet guardians` as a program or a file tells it: who holds what, sheets, and a wallet made again from them."""

from __future__ import annotations

import functools
import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result
from shamir_mnemonic import shamir

from clients.wallet.cli.main import wallet
from clients.wallet.presentation.guardian_sheets import read_written
from clients.wallet.recovery.slip39_shares import SHARE_WORDS_COUNT, read_share, tokenize_words
from clients.wallet.store import wallet_lock
from clients.wallet.store.keystore import Keystore, WalletContent
from clients.wallet.store.member_keys import derive_keys
from consensus.errors import BlockRobotError
from tests.world.dicts import CHEAP
from tests.world.stolen import OLD_WORDS, WalletHarness

WORDS = " ".join(["abandon"] * 23 + ["art"])
PASSPHRASE = "violet kettle orbit sandwich"
THREE = ("--guardian", "Ann", "--guardian", "Ben", "--guardian", "Çleo & <Co>")


class Home:
    """Somebody's wallets in a folder, and nobody at the terminal."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *arguments: str, profile: str = "default", typed: str | None = None) -> Result:
        group = ["--wallet-dir", str(self.folder), "--genesis", str(self.folder / "none"), "--profile", profile]
        return CliRunner().invoke(wallet, [*group, "guardians", *arguments], input=typed)

    def json(self, *arguments: str, code: int = 0, profile: str = "default") -> dict[str, Any]:
        done = self.run(*arguments, "--json", profile=profile)
        assert done.exit_code == code, done.output
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    def split(self, *arguments: str, out: str = "sheets") -> dict[str, Any]:
        return self.json("split", *THREE, *arguments, "--out", str(self.folder / out))

    def recover(self, *sheets: str, code: int = 0, profile: str = "again", options: tuple[str, ...] = ()) -> Any:
        named = [part for sheet in sheets for part in ("--share", sheet)]
        answer = self.json("recover", *named, "--fast-passphrase", *options, code=code, profile=profile)
        return answer if code == 0 else answer["error"]

    def open(self, profile: str = "default") -> Keystore:
        return Keystore.open(self.folder / f"{profile}.wallet", PASSPHRASE)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    Keystore.create(tmp_path / "default.wallet", WORDS, PASSPHRASE, CHEAP)
    (tmp_path / "passphrase").write_text(PASSPHRASE + "\n")
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(tmp_path / "passphrase"))
    return Home(tmp_path)


def words_in(sheet: str) -> list[str]:
    return tokenize_words(read_written(Path(sheet)))


def tells_of(told: str, words: list[str]) -> bool:
    """Tell whether a text holds any two words of a share side by side; single ones are in any English text."""
    plain = " ".join(re.findall("[a-z]+", told.lower()))
    return any(f"{one} {next_one}" in plain for one, next_one in pairwise(words))


def test_any_two_of_three_sheets_make_the_same_wallet_again(home: Home) -> None:
    made = home.split()
    assert (made["threshold"], made["handed_over"], made["guardians"]) == (2, 3, ["Ann", "Ben", "Çleo & <Co>"])
    first, second, third = made["sheets"]
    for number, pair in enumerate([(first, second), (third, first), (second, third)]):
        profile = f"again-{number}"
        told = home.recover(*pair, profile=profile)
        assert told["member"] == derive_keys(WORDS).identity.public_key.hex()
        assert (told["words_checked"], told["membership"]) == (False, "not_asked")
        assert home.open(profile).content.words == WORDS


def test_the_wallet_remembers_who_and_when_and_no_word(home: Home) -> None:
    made = home.split()
    (remembered,) = home.json("list")["sets"]
    assert remembered == {name: made[name] for name in remembered}
    assert remembered["words_in_force"] is True
    kept = repr(home.open().content) + repr(home.open().content.guardian_sets) + json.dumps(made)
    assert not [sheet for sheet in made["sheets"] if tells_of(kept, words_in(sheet))]
    listed = home.run()
    assert listed.exit_code == 0
    assert "Ann, Ben, Çleo & <Co>" in listed.output
    assert home.json()["sets"] == [remembered], "without a command it lists"
    assert home.run("--json", "list").exit_code == 2


def test_beside_an_open_page_it_lists_and_hands_out_nothing(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("claim_wallet", "lock_or_read_only"):
        at_once = functools.partial(getattr(wallet_lock, name), wait_s=0, sleep=lambda _: None)
        monkeypatch.setattr(f"clients.wallet.commands.account.guardians_commands.{name}", at_once)
    with wallet_lock.claim_wallet(home.folder / "default.wallet"):
        assert home.json("list")["sets"] == []
        refused = home.json("split", *THREE, "--out", str(home.folder / "sheets"), code=1)
    assert refused["error"]["code"] == "WALLET_BUSY"
    assert not (home.folder / "sheets").exists()


def test_without_guardians_it_says_what_to_type(home: Home) -> None:
    assert home.json("list") == {"ok": True, "sets": []}
    places = f"--wallet-dir {home.folder} --genesis {home.folder / 'none'}"
    assert f"blockrobot wallet --profile work {places} guardians split --guardian NAME" in _listed(home, "work")


def _listed(home: Home, profile: str) -> str:
    (home.folder / f"{profile}.wallet").write_bytes((home.folder / "default.wallet").read_bytes())
    return home.run("list", profile=profile).output


def test_the_same_dice_give_the_same_shares(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    sheets = []
    for name in ("one", "two"):
        dice = iter(range(10_000))
        monkeypatch.setattr(
            shamir, "RANDOM_BYTES", lambda count, dice=dice: bytes(next(dice) % 256 for _ in range(count))
        )
        sheets.append([words_in(sheet) for sheet in home.split("--yes", out=name)["sheets"]])
    assert sheets[0] == sheets[1]
    share = read_share(" ".join(sheets[0][1]))
    assert (share.extendable, share.iteration_exponent, share.index, share.group_count) == (True, 1, 1, 1)


def test_a_sheet_is_for_its_user_alone_and_names_no_other_guardian(home: Home) -> None:
    sheets = home.split()["sheets"]
    assert (home.folder / "sheets").stat().st_mode & 0o777 == 0o700
    assert [Path(sheet).name for sheet in sheets] == ["1.html", "2.html", "3.html"], (
        "who may list the folder learns no name"
    )
    for sheet in sheets:
        assert Path(sheet).stat().st_mode & 0o777 == 0o600
        page = Path(sheet).read_text(encoding="utf-8")
        assert "default-src 'none'" in page
        assert "<script" not in page
        assert "http" not in page.replace("http-equiv", "")
        assert page.count("<li>") == SHARE_WORDS_COUNT + 8
        assert len(words_in(sheet)) == SHARE_WORDS_COUNT
        assert len(page) < 20_000
    last = Path(sheets[2]).read_text(encoding="utf-8")
    assert "Çleo &amp; &lt;Co&gt;" in last
    assert "Ann" not in last
    assert derive_keys(WORDS).identity.public_key.hex()[:8] not in last


@pytest.mark.parametrize("marked", ["<![", "<![x[", "<![ ", "<![%"])
def test_a_sheet_that_is_no_html_is_refused_as_a_share(home: Home, marked: str) -> None:
    sheet = home.folder / "sheet.html"
    sheet.write_text("<!doctype html>" + marked * 1_000)
    refused = [home.run("check", str(sheet), "--json"), home.run("check", "--json", typed=sheet.read_text())]
    assert [json.loads(each.stdout)["error"]["code"] for each in refused] == ["SHARE_INVALID"] * 2


def test_sheets_that_cannot_all_be_written_are_taken_back(home: Home) -> None:
    folder = home.folder / "sheets"
    folder.mkdir()
    (folder / "2.html").write_text("of another set")
    refused = home.json("split", *THREE, "--out", str(folder), code=1)
    assert refused["error"]["code"] == "SHEETS_FOLDER_USED"
    assert "Choose a new folder" in refused["error"]["next_step"]
    assert [path.name for path in folder.iterdir()] == ["2.html"]
    assert home.json("list")["sets"] == []


@pytest.mark.parametrize("kept_as", ["3.html", "1-ann.html", "for Zoé.HTM"])
def test_sheets_of_two_sets_come_into_no_folder_together(home: Home, kept_as: str) -> None:
    folder = home.folder / "sheets"
    first, second, third = (Path(sheet) for sheet in home.split()["sheets"])
    for sheet in (first, second):
        sheet.unlink()
    third.rename(folder / kept_as)
    refused = home.json("split", "--guardian", "Dia", "--guardian", "Eva", "--yes", "--out", str(folder), code=1)
    assert refused["error"]["code"] == "SHEETS_FOLDER_USED"
    assert kept_as in refused["error"]["detail"]
    assert [path.name for path in folder.iterdir()] == [kept_as]
    assert len(home.json("list")["sets"]) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--guardian", "Ann"), "Name 2 to 16 guardians"),
        ((), "Name 2 to 16 guardians"),
        (tuple(part for number in range(17) for part in ("--guardian", f"G{number}")), "Name 2 to 16 guardians"),
        ((*THREE, "--threshold", "1"), "each of them would have your wallet"),
        ((*THREE, "--threshold", "4"), "cannot be needed"),
        ((*THREE, "--threshold", "-3"), "each of them would have your wallet"),
        (("--guardian", "Ann", "--guardian", " ann "), "tell them apart"),
        (("--guardian", "Ann", "--guardian", "Be\x1bn"), "can be printed"),
        (("--guardian", "Ann", "--guardian", "x" * 41), "can be printed"),
        (("--guardian", "Ann", "--guardian", " "), "can be printed"),
        ((*THREE, "--former", "1"), "has 0 former words"),
    ],
)
def test_ways_that_make_no_sense_are_wrong_usage(home: Home, arguments: tuple[str, ...], said: str) -> None:
    refused = home.run("split", *arguments, "--out", str(home.folder / "sheets"))
    assert refused.exit_code == 2
    assert said in refused.output
    assert not (home.folder / "sheets").exists()
    assert home.open().content.guardian_sets == []


def test_without_a_terminal_words_go_onto_sheets_or_nowhere(home: Home) -> None:
    for more in ((), ("--json",)):
        assert home.run("split", *THREE, *more).exit_code == 2
    assert home.run("recover").exit_code == 2
    assert home.run("recover", "--words-only", "--share", __file__).exit_code == 2
    assert home.run("recover", "--show-words", "--share", __file__).exit_code == 2


def test_a_second_set_is_asked_for_and_the_first_still_works(home: Home) -> None:
    first = home.split()
    asked = home.run("split", *THREE, "--out", str(home.folder / "more"))
    assert asked.exit_code == 2
    assert "At least 1 earlier set of these words goes on working" in asked.output
    assert len(home.json("list")["sets"]) == 1
    second = home.split("--yes", out="more")
    assert second["identifier"] != first["identifier"] or words_in(first["sheets"][0]) != words_in(second["sheets"][0])
    home.recover(*first["sheets"][:2])
    assert home.recover(first["sheets"][0], second["sheets"][1], profile="mixed", code=1)["code"] in {
        "SHARE_OF_ANOTHER_SPLIT",
        "SHARES_CONTRADICT",
    }
    assert not (home.folder / "mixed.wallet").exists()


def test_the_keyring_s_passphrase_does_not_do_for_splitting(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    def unused(*_: object) -> str:
        raise AssertionError

    monkeypatch.setattr("clients.wallet.cli.wallet_context.read_from_keyring", unused)
    out = str(home.folder / "sheets")
    group = ["--wallet-dir", str(home.folder), "--keyring", "guardians", "split", *THREE, "--out", out, "--json"]
    done = CliRunner().invoke(wallet, group)
    assert done.exit_code == 0, done.output


def test_too_few_a_repeated_one_and_spoilt_words_make_no_wallet(home: Home) -> None:
    first, second, _ = home.split()["sheets"]
    good = words_in(first)
    spoilt, unknown, short = (home.folder / name for name in ("spoilt.txt", "unknown.txt", "short.txt"))
    spoilt.write_text(" ".join([*good[1:4], good[0], *good[4:]]))
    unknown.write_text(" ".join([*good[:11], "secretword", *good[12:]]))
    short.write_text(" ".join(good[:-1]))
    for files, code in (
        ((first,), "SHARES_TOO_FEW"),
        ((first, first), "SHARE_REPEATED"),
        ((second, str(spoilt)), "SHARE_INVALID"),
        ((second, str(unknown)), "SHARE_WORD_UNKNOWN"),
        ((second, str(short)), "SHARE_INVALID"),
        ((second, str(home.folder / "default.wallet")), "FILE_UNUSABLE"),
    ):
        refused = home.recover(*files, code=1)
        assert refused["code"] == code
        assert "secretword" not in refused["detail"], "a word is named by its number"
        assert not (home.folder / "again.wallet").exists()
    assert "unknown.txt: Word 12 is not on the list." in home.recover(str(unknown), code=1)["detail"]
    assert "32 words, not 33" in home.recover(str(short), code=1)["detail"]


def test_a_guardian_whose_words_would_do_alone_puts_no_wallet_of_his_in_the_place_of_hers(home: Home) -> None:
    """`split` makes no set of one; another program does, and under any number."""
    first, second, _ = home.split()["sheets"]
    own = bytes(range(32))
    ((alone,),) = shamir.generate_mnemonics(1, [(1, 1)], own)
    under_her_number = replace(read_share(alone), identifier=read_share(read_written(Path(first))).identifier)
    for number, words in enumerate((alone, under_her_number.mnemonic())):
        forged = home.folder / f"forged-{number}.txt"
        forged.write_text(words)
        for files in ((str(forged),), (str(forged), second), (second, str(forged))):
            refused = home.recover(*files, code=1)
            assert refused["code"] == "SHARE_INVALID"
            assert "alone" in refused["detail"]
            assert not (home.folder / "again.wallet").exists()
        assert home.json("check", str(forged), code=1)["error"]["code"] == "SHARE_INVALID"


def test_a_sheet_that_was_changed_is_left_out_and_named(home: Home) -> None:
    first, second, third = home.split()["sheets"]
    honest = read_share(read_written(Path(first)))
    changed = home.folder / "changed.txt"
    changed.write_text(replace(honest, member_threshold=3).mnemonic())
    told = home.recover(str(changed), second, third)
    assert told["left_out"] == [{"identifier": honest.identifier, "sheet": 1}]
    assert home.open("again").content.words == WORDS
    assert home.open("again").content.guardian_sets[0].threshold == 2
    refused = home.recover(str(changed), second, profile="short", code=1)
    assert refused["code"] == "SHARE_OF_ANOTHER_SPLIT"
    assert "says something else of it" in refused["detail"]


def test_where_a_wallet_is_already_nobody_is_asked_for_anything(home: Home) -> None:
    first, second, _ = home.split()["sheets"]
    assert home.recover(first, second, profile="default", code=1)["code"] == "WALLET_EXISTS"


def test_a_guardian_checks_alone_what_she_holds(home: Home) -> None:
    made = home.split()
    told = home.json("check", made["sheets"][1])
    assert told == {"ok": True, "identifier": made["identifier"], "sheet": 2, "threshold": 2}
    words = words_in(made["sheets"][1])
    typed = "\n".join(f"{number}. {word}" for number, word in enumerate(words, 1))
    for arguments in (("check",), ("check", "-")):
        whole = home.run(*arguments, typed=typed)
        assert whole.exit_code == 0
        assert f"sheet 2 of set {made['identifier']:05d}" in whole.output
        assert not tells_of(whole.output, words)
    sheet = Path(made["sheets"][1]).read_text(encoding="utf-8")
    assert home.run("check", "-", typed=sheet).exit_code == 0
    saved_by_a_browser = home.folder / "saved.html"
    saved_by_a_browser.write_text(sheet.replace("<!doctype", "<!DOCTYPE"), encoding="utf-8-sig")
    assert home.json("check", str(saved_by_a_browser)) == told
    wrong = home.run("check", typed=" ".join(words[:20]))
    assert wrong.exit_code == 1
    assert "These are 20 words, not 33." in wrong.output
    assert home.run("check", str(home.folder / "nowhere")).exit_code == 2


def test_a_sheet_that_is_far_too_large_is_no_sheet(home: Home) -> None:
    large = home.folder / "large.txt"
    large.write_text("academic " * 60_000)
    assert home.json("check", str(large), code=1)["error"]["code"] == "SHARE_INVALID"


def test_the_words_come_out_only_where_they_were_asked_for(home: Home) -> None:
    first, second, _ = home.split()["sheets"]
    written = home.folder / "words.txt"
    told = home.recover(first, second, options=("--words-file", str(written)))
    assert "abandon" not in json.dumps(told)
    assert written.read_text().strip() == WORDS
    assert written.stat().st_mode & 0o777 == 0o600
    only = home.folder / "only.txt"
    again = home.run("recover", "--share", first, "--share", second, "--words-file", str(written), profile="third")
    assert again.exit_code == 2, "nothing is written over, and that is said before anything is made"
    assert not (home.folder / "third.wallet").exists()
    told = home.recover(first, second, profile="none", options=("--words-only", "--words-file", str(only)))
    assert told == {"ok": True, "words_file": str(only), "left_out": []}
    assert only.read_text().strip() == WORDS
    assert not (home.folder / "none.wallet").exists()


def test_where_the_words_cannot_go_is_said_before_any_share_is_read(home: Home) -> None:
    first, second, _ = home.split()["sheets"]
    nowhere = home.folder / "nowhere" / "words.txt"
    refused = home.run("recover", "--share", first, "--share", second, "--words-file", str(nowhere), profile="again")
    assert refused.exit_code == 2
    assert "no folder" in refused.output
    assert not (home.folder / "again.wallet").exists()


def test_words_that_cannot_be_written_after_all_leave_no_wallet_in_the_way(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, _ = home.split()["sheets"]
    words_file = home.folder / "words.txt"

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("clients.wallet.commands.account.guardians_recover_commands.write_words", full)
    refused = home.recover(first, second, options=("--words-file", str(words_file)), code=1)
    assert refused["code"] == "FILE_UNUSABLE"
    assert not (home.folder / "again.wallet").exists()
    monkeypatch.undo()
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(home.folder / "passphrase"))
    home.recover(first, second, options=("--words-file", str(words_file)))
    assert words_file.read_text().strip() == WORDS


@pytest.mark.parametrize("is_made", [False, True])
def test_a_recovery_that_is_stopped_says_what_it_left(
    home: Home, monkeypatch: pytest.MonkeyPatch, is_made: bool
) -> None:
    first, second, _ = home.split()["sheets"]
    words_file = home.folder / "words.txt"

    def stop(*_: object, **__: object) -> bool:
        raise KeyboardInterrupt

    step = "_ask_network" if is_made else "restore_wallet"
    monkeypatch.setattr(f"clients.wallet.commands.account.guardians_recover_commands.{step}", stop)
    options = ("--words-file", str(words_file), "--fast-passphrase")
    stopped = home.run("recover", "--share", first, "--share", second, *options, profile="again")
    assert stopped.exit_code == 1
    told = "The wallet was made all the same" if is_made else "No wallet was made"
    assert told in stopped.output
    assert str(words_file) in stopped.output.replace("\n", "")
    assert words_file.read_text().strip() == WORDS, "the guardians may have gone home"
    assert (home.folder / "again.wallet").exists() == is_made


def test_a_recovered_wallet_knows_its_set_and_warns_before_the_next(home: Home) -> None:
    made = home.split()
    home.recover(*made["sheets"][1:])
    (known,) = home.json("list", profile="again")["sets"]
    assert (known["identifier"], known["threshold"], known["guardians"]) == (made["identifier"], 2, [])
    assert "Their names the wallet does not know" in home.run(profile="again").output
    refused = home.run("split", *THREE, "--out", str(home.folder / "next"), profile="again")
    assert "earlier set of these words goes on working" in refused.output


def test_new_words_leave_old_sets_to_the_former_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = WalletHarness(tmp_path, monkeypatch)

    def run(*arguments: str, profile: str = "ann") -> dict[str, Any]:
        done = desk.run("guardians", *arguments, "--json", profile=profile)
        assert done.exit_code == 0, done.output
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    old = run("split", *THREE, "--out", str(tmp_path / "old"))["sheets"]
    assert desk.rotate().exit_code == 0
    assert run("list")["sets"][0]["words_in_force"] is False
    listed = " ".join(desk.run("guardians").output.split())
    assert "This wallet knows of no guardians" in listed
    assert "opens what was recorded under them, and decides of nothing any more" in listed
    new = run("split", *THREE, "--out", str(tmp_path / "new"))["sheets"]
    again = run("split", *THREE, "--former", "1", "--yes", "--out", str(tmp_path / "again"))["sheets"]
    for name, sheets in (("old", old), ("again", again)):
        only = ("--words-only", "--words-file", str(tmp_path / f"{name}.txt"))
        run("recover", "--share", sheets[0], "--share", sheets[2], *only)
        assert (tmp_path / f"{name}.txt").read_text().strip() == OLD_WORDS
    (tmp_path / "passphrase").write_text(PASSPHRASE)
    files = ("--share", new[0], "--share", new[1], "--former", str(tmp_path / "old.txt"), "--fast-passphrase")
    told = run("recover", *files, profile="found")
    assert (told["words_checked"], told["membership"]) == (True, "member")
    assert Keystore.open(tmp_path / "found.wallet", PASSPHRASE).content.former == [OLD_WORDS]
    told = run("recover", "--share", old[0], "--share", old[1], "--fast-passphrase", profile="late")
    assert told["membership"] == "nobody", "an old set makes a wallet whose words are no member's any more"


def test_words_that_are_about_to_be_replaced_are_not_split(home: Home) -> None:
    store = home.open()
    store.content.next_words = WORDS
    store.save()
    refused = home.json("split", *THREE, "--out", str(home.folder / "sheets"), code=1)
    assert refused["error"]["code"] == "WALLET_ROTATION_OPEN"


def test_a_wallet_of_before_guardians_opens_and_has_none() -> None:
    before = {"words": WORDS, "scanned_count": 7}
    content = msgspec.msgpack.decode(msgspec.msgpack.encode(before), type=WalletContent)
    assert (content.guardian_sets, content.scanned_count) == ([], 7)


def test_no_error_of_shares_names_a_word() -> None:
    with pytest.raises(BlockRobotError, match="Word 1 is not on the list") as refused:
        read_share("hunter2secret")
    assert "hunter" not in str(refused.value)
