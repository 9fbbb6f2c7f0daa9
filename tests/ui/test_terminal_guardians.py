"""Guardians at a terminal: words shown and asked back, a wallet lost on a real network, and made again by two of three."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from clients.wallet.recovery.slip39_shares import read_share, split_mnemonic
from clients.wallet.store.keystore import Keystore
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.typed import CONTROL, ROWS, WIPED, Typed, at_terminal, plain
from tests.world.dicts import CHEAP

WORDS = " ".join(["abandon"] * 23 + ["art"])
PASSPHRASE = "violet kettle orbit sandwich"
NAMES = ("Ann [b]", "Ben", "Zoé")
WRITTEN = r"(?s)(?:When all of|Quando estiver)[^:]*Enter: "


def words_shown(typed: Typed) -> list[str]:
    """Return the words that stand on the screen, in the order of their numbers."""
    shown = CONTROL.sub("", str(typed.before)).rpartition("sheet")[2].rpartition("folha")[2].partition(":")[2]
    found = {int(number): word for number, word in re.findall(r"(\d+) ([a-z]+)", shown)}
    assert sorted(found) == list(range(1, 34))
    return [found[number] for number in sorted(found)]


def answer_check(typed: Typed, words: list[str]) -> None:
    for _ in range(3):
        typed.expect(r"(?:Word number|Palavra número|Palavra numero) (\d+): ")
        typed.sendline(words[int(typed.match[1]) - 1])


def split_at(home: Path, *group: str, passphrase: str = PASSPHRASE, **terminal: Any) -> list[list[str]]:
    """Split at a terminal, answer what is asked back, and return every guardian's words."""
    named = [part for name in NAMES for part in ("--guardian", name)]
    typed = at_terminal(home, *group, "guardians", "split", *named, **terminal)
    typed.answer("(?i)(pass|frase)[^:]*: ", passphrase)
    shares = []
    for number in range(1, len(NAMES) + 1):
        typed.answer(rf"\({number} (?:of|de) 3\)[^:]*Enter: ", "")
        typed.expect(WRITTEN)
        assert WIPED in typed.before
        shares.append(words_shown(typed))
        typed.sendline("")
        typed.expect_exact(WIPED)
        typed.expect("(?s)(?:To see that|Para ver se)")
        answer_check(typed, shares[-1])
        typed.expect_exact(WIPED)
    assert typed.ended() == 0, typed.rest()
    assert not any(" ".join(pair) in plain(typed.rest()) for share in shares for pair in pairwise(share))
    return shares


def begin_recovery(home: Path, *group: str, options: tuple[str, ...] = (), **terminal: Any) -> Typed:
    return at_terminal(home, *group, "guardians", "recover", "--fast-passphrase", *options, **terminal)


def type_words(typed: Typed, words: list[str], a_line: int = 11) -> None:
    """Type words, some in a line, each line after it was asked for."""
    for start in range(0, len(words), a_line):
        typed.answer(r"(?:Word|Palavra) \d+: ", " ".join(words[start : start + a_line]))


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A home with a wallet of known words, and no network."""
    Keystore.create(tmp_path / "wallets" / "default.wallet", WORDS, PASSPHRASE, CHEAP)
    return tmp_path


@pytest.mark.parametrize(
    "terminal",
    [
        {"columns": 24, "environment": {"NO_COLOR": "1"}},
        {"columns": 40, "environment": {"LC_ALL": "C", "BLOCKROBOT_LANGUAGE": "pt"}},
        {"columns": 100},
    ],
    ids=["narrow and without colour", "in Portuguese without UTF-8", "wide"],
)
def test_each_guardian_s_words_are_shown_alone_and_asked_back(home: Path, terminal: dict[str, Any]) -> None:
    shares = split_at(home, **terminal)
    assert len({tuple(share) for share in shares}) == 3
    again = begin_recovery(home, "--profile", "again", **terminal)
    for share in (shares[2], shares[0]):
        type_words(again, share)
    again.choose_passphrase(PASSPHRASE)
    assert again.ended() == 0, again.rest()
    assert Keystore.open(home / "wallets" / "again.wallet", PASSPHRASE).content.words == WORDS
    (known,) = Keystore.open(home / "wallets" / "default.wallet", PASSPHRASE).content.guardian_sets
    assert (known.guardians, known.handed_count) == (list(NAMES), 3)


def test_a_terminal_that_cannot_wipe_gets_so_many_lines_that_no_word_is_left_on_it(home: Path) -> None:
    typed = at_terminal(home, "guardians", "split", "--guardian", "Ann", "--guardian", "Ben", term="dumb")
    typed.answer("(?i)pass[^:]*: ", PASSPHRASE)
    typed.answer("Enter: ", "")
    typed.expect(WRITTEN)
    words = words_shown(typed)
    typed.sendline("")
    typed.expect(rf"(?:\r?\n){{{ROWS + 1},}}")
    answer_check(typed, words)
    typed.expect(rf"(?:\r?\n){{{ROWS + 1},}}")
    typed.expect("Enter: ")
    assert typed.ended_by_ctrl_c() == 1
    assert "\x1b" not in typed.rest()


def test_the_words_are_off_the_screen_when_they_are_asked_back_and_come_again_when_wished(home: Path) -> None:
    typed = at_terminal(home, "guardians", "split", "--guardian", "Ann", "--guardian", "Ben")
    typed.answer("(?i)pass[^:]*: ", PASSPHRASE)
    typed.answer("Enter: ", "")
    typed.expect(WRITTEN)
    words = words_shown(typed)
    typed.sendline("")
    typed.expect_exact(WIPED)
    typed.expect(r"Word number (\d+): ")
    number = typed.match[1]
    for _ in range(9):
        typed.sendline("?")
        typed.expect(WRITTEN)
        assert words_shown(typed) == words, "to look again is no wrong answer"
        typed.sendline("")
        typed.expect_exact(WIPED)
        typed.expect(f"Word number {number}: ")
    typed.sendline("wrong")
    typed.expect("is not word")
    typed.answer(f"Word number {number}: ", words[int(number) - 1])
    for _ in range(2):
        typed.expect(r"Word number (\d+): ")
        typed.sendline(words[int(typed.match[1]) - 1])
    typed.expect("Ben .2 of 2")
    assert typed.ended_by_ctrl_c() == 1


def test_ctrl_c_wipes_the_screen_and_the_wallet_says_that_the_set_is_not_whole(home: Path) -> None:
    typed = at_terminal(home, "guardians", "split", *[part for name in NAMES for part in ("--guardian", name)])
    typed.answer("(?i)pass[^:]*: ", PASSPHRASE)
    typed.answer("Enter: ", "")
    typed.expect(WRITTEN)
    words = words_shown(typed)
    typed.sendline("")
    answer_check(typed, words)
    typed.answer("Enter: ", "")
    typed.expect(WRITTEN)
    typed.press_ctrl_c(re.escape(WIPED))
    typed.expect("Cut short after 1 of 3")
    assert typed.ended() == 1
    told = at_terminal(home, "guardians")
    told.answer("(?i)pass[^:]*: ", PASSPHRASE)
    told.expect("Cut short: 1 of 3 have their words")
    assert told.ended() == 0


def test_ctrl_c_before_any_word_was_shown_leaves_nothing(home: Path) -> None:
    typed = at_terminal(home, "guardians", "split", "--guardian", "Ann", "--guardian", "Ben")
    typed.answer("(?i)pass[^:]*: ", PASSPHRASE)
    typed.expect("All 2 are needed")
    typed.expect("Enter: ")
    assert typed.ended_by_ctrl_c() == 1
    assert "Cut short" not in typed.rest()
    assert Keystore.open(home / "wallets" / "default.wallet", PASSPHRASE).content.guardian_sets == []


def test_a_wrong_word_another_set_and_the_same_guardian_twice_are_told_at_once(home: Path) -> None:
    shares, others = split_at(home), []
    Keystore.create(home / "wallets" / "other.wallet", WORDS, PASSPHRASE, CHEAP)
    others = split_at(home, "--profile", "other")
    typed = begin_recovery(home, "--profile", "again")
    typed.answer("Word 1: ", " ".join([*shares[0][:4], "acadmic", *shares[0][5:]]))
    typed.expect('Word 5, "acadmic", is on no sheet. Did you mean academic, ')
    typed.answer("Word 5: ", " ".join(shares[0][4:]))
    typed.expect_exact(WIPED)
    typed.expect("sheet 1 of set .*1 more guardian is needed")
    type_words(typed, shares[0])
    typed.expect("SHARE_REPEATED. Next step")
    type_words(typed, others[1], 33)
    typed.expect("SHARE_OF_ANOTHER_SPLIT|SHARES_CONTRADICT")
    swapped = [*shares[1][:6], shares[1][7], shares[1][6], *shares[1][8:]]
    type_words(typed, swapped, 33)
    typed.expect("but not together")
    for place in (6, 7):
        typed.answer("Number of a wrong word[^:]*: ", str(place + 1))
        typed.answer(f"Word {place + 1} is: ", shares[1][place])
    typed.expect("lead to one wallet")
    typed.answer("does not fit: sheet 2 of set.*Go on with these", "y")
    typed.choose_passphrase(PASSPHRASE)
    assert typed.ended() == 0, typed.rest()
    assert Keystore.open(home / "wallets" / "again.wallet", PASSPHRASE).content.words == WORDS


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({}, "SHARES_CONTRADICT. Next step: Add the words of one more guardian"),
        ({"index": 1}, "SHARES_CONTRADICT.*It is kept"),
        ({"member_threshold": 3}, "SHARE_OF_ANOTHER_SPLIT.*It is kept"),
        ({"iteration_exponent": 2}, "SHARE_OF_ANOTHER_SPLIT.*It is kept"),
    ],
    ids=["of the words alone", "of her number", "of how many are needed", "of how it was made"],
)
def test_a_guardian_who_lies_is_made_up_for_by_one_more(home: Path, said: dict[str, int], told: str) -> None:
    shares = split_at(home)
    lie = replace(read_share(" ".join(shares[0])), value=bytes(range(32)), **said)
    typed = begin_recovery(home, "--profile", "again")
    for share in (lie.words(), shares[1]):
        type_words(typed, share, 33)
    typed.expect(f"(?s){told}")
    type_words(typed, shares[2], 33)
    typed.expect(f"does not fit: sheet {lie.index + 1} of set")
    typed.answer("any 2 guardians are enough.*Go on with these", "y")
    typed.choose_passphrase(PASSPHRASE)
    assert typed.ended() == 0, typed.rest()
    assert Keystore.open(home / "wallets" / "again.wallet", PASSPHRASE).content.words == WORDS


def test_who_remembers_that_more_were_needed_than_liars_say_makes_no_wallet_of_theirs(home: Path) -> None:
    """Two of three who are needed cannot have hers; they may offer one of their own."""
    honest = split_mnemonic(WORDS, 3, 5)[0]
    theirs = split_mnemonic(" ".join(["zoo"] * 23 + ["vote"]), 2, 2)
    typed = begin_recovery(home, "--profile", "again")
    for share in (honest, *theirs):
        type_words(typed, share.split(), 33)
    typed.answer("(?s)does not fit: sheet 1 of set.*any 2 guardians are enough.*Go on with these", "n")
    assert typed.ended() == 1
    assert not (home / "wallets" / "again.wallet").exists()


def test_ctrl_c_while_words_are_typed_wipes_them_and_makes_nothing(home: Path) -> None:
    typed = begin_recovery(home, "--profile", "again")
    typed.answer("Word 1: ", "academic acid")
    typed.expect("Word 3: ")
    typed.press_ctrl_c(re.escape(WIPED))
    assert typed.ended() == 1
    assert [path.name for path in (home / "wallets").iterdir() if "again" in path.name] == []


def test_a_guardian_checks_hers_at_a_terminal(home: Path) -> None:
    shares = split_at(home)
    typed = at_terminal(home, "guardians", "check")
    type_words(typed, shares[1])
    typed.expect_exact(WIPED)
    typed.expect("sheet 2 of set")
    assert typed.ended() == 0
    assert "Any 2 guardians of this set" in plain(typed.rest())


def test_where_a_wallet_is_nobody_types_ninety_nine_words_for_nothing(home: Path) -> None:
    typed = begin_recovery(home)
    typed.expect("WALLET_EXISTS. Next step")
    assert typed.ended() == 1


async def test_a_wallet_that_is_lost_comes_back_by_two_of_three_and_opens_what_was_recorded(
    recorded_network: RecordedNetwork, tmp_path: Path
) -> None:
    ann = recorded_network
    group = ann.wallet_arguments[1:]
    file = ann.wallet_dir / f"{ann.profile}.wallet"
    name = ann.records[0].record_id.hex()

    def tell_the_story() -> str:
        words = Keystore.open(file, ann.passphrase).content.words
        shares = split_at(ann.folder, *group, passphrase=ann.passphrase)
        file.unlink()
        gone = at_terminal(ann.folder, *group, "records")
        gone.expect("(?s)WALLET_NOT_FOUND. Next step.*guardians recover`")
        assert gone.ended() == 3
        typed = begin_recovery(ann.folder, *group)
        for share in (shares[1], shares[2]):
            type_words(typed, share)
        typed.choose_passphrase(PASSPHRASE)
        typed.expect("these words are a member's")
        assert typed.ended() == 0, typed.rest()
        assert Keystore.open(file, PASSPHRASE).content.words == words
        seen = at_terminal(ann.folder, *group, "view", name[:12], "--out", str(tmp_path / "pictures"), "--no-show")
        seen.expect("(?i)pass[^:]*: ")
        seen.sendline(PASSPHRASE)
        assert seen.ended() == 0, seen.rest()
        return seen.rest()

    told = await asyncio.to_thread(tell_the_story)
    assert "are as the robot took them" in plain(told)
    assert list((tmp_path / "pictures").rglob("*.depth.png"))


@pytest.mark.parametrize(
    "arguments",
    [
        ("guardians", "split", "--guardian", "Ann", "--guardian", "Ben", "--no-check"),
        ("guardians", "check"),
        ("--profile", "again", "guardians", "recover", "--fast-passphrase"),
        ("--profile", "again", "guardians", "recover", "--share", __file__, "--show-words"),
        ("--profile", "again", "new", "--no-check", "--fast-passphrase"),
    ],
    ids=["split", "check", "recover", "recover with words", "new"],
)
def test_what_would_be_shown_goes_to_no_pipe_though_somebody_sits_at_the_keyboard(
    home: Path, arguments: tuple[str, ...]
) -> None:
    typed = at_terminal(home, *arguments, output=home / "log", environment={"FORCE_COLOR": "1"})
    assert typed.ended() == 2
    assert "There is no terminal to" in typed.rest()
    assert (home / "log").read_text() == ""
