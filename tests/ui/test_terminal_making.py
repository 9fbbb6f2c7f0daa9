"""A wallet made, restored and misused at a terminal, as a person types it. No network is there.

The commands run in a process of their own, behind a pseudo-terminal.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clients.wallet.store.keystore import Keystore
from tests.ui.typed import CONTROL, ROWS, WIPED, Typed, at_terminal

ABANDON = " ".join(["abandon"] * 23 + ["art"])


def make(home: Path, *arguments: str, language: str = "en", **terminal: object) -> Typed:
    typed = at_terminal(home, "--language", language, *arguments, **terminal)  # type: ignore[arg-type]
    typed.choose_passphrase("tea and lemon cake")
    return typed


def words_shown(typed: Typed) -> dict[int, str]:
    shown = CONTROL.sub("", str(typed.before)).rpartition("wallet:")[2].rpartition("carteira:")[2]
    found = {int(number): word for number, word in re.findall(r"(\d+) ([a-z]+)", shown)}
    assert sorted(found) == list(range(1, 25))
    return found


def write_down(typed: Typed) -> dict[int, str]:
    """Wait for the words, press Enter once they are written down, and return them by their numbers."""
    typed.expect("(?:press|prima) Enter: ")
    words = words_shown(typed)
    typed.sendline("")
    return words


def answer_check(typed: Typed, words: dict[int, str]) -> None:
    for _ in range(3):
        typed.expect(r"Word number (\d+): ")
        typed.sendline(words[int(typed.match[1])])


@pytest.mark.smoke
@pytest.mark.parametrize("columns", [24, 40, 100])
def test_new_asks_three_words_back_until_they_are_right(tmp_path: Path, columns: int) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase", columns=columns)
    words = write_down(typed)
    typed.expect("(?s)To see that")
    typed.answer(r"Word number (\d+): ", "wrong")
    typed.expect("Look again")
    for _ in range(3):
        typed.expect(r"Word number (\d+): ")
        assert not (tmp_path / "wallets" / "default.wallet").exists(), "first the words, then the wallet"
        typed.sendline(words[int(typed.match[1])])
    assert typed.ended() == 0
    assert (tmp_path / "wallets" / "default.wallet").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(("language", "lost"), [("en", "lost it, stop here"), ("pt", "a perdeu, pare aqui")])
def test_before_a_new_wallet_is_made_it_says_how_a_lost_one_comes_back(
    tmp_path: Path, language: str, lost: str
) -> None:
    typed = at_terminal(tmp_path, "--language", language, "--profile", "ann", "new", columns=400)
    typed.expect(lost)
    typed.expect("blockrobot wallet --profile ann restore")
    typed.expect("blockrobot wallet --profile ann guardians recover")
    typed.expect("(?i)pass[^:]*: ")
    assert typed.ended_by_ctrl_c() == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_the_words_are_off_the_screen_before_they_are_asked_back_and_what_was_typed_after(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    words = write_down(typed)
    typed.expect_exact(WIPED)
    answer_check(typed, words)
    typed.expect_exact(WIPED)
    typed.expect("Your wallet is")
    assert typed.ended() == 0
    left = CONTROL.sub("", typed.rest())
    assert not any(f"{words[number]} {words[number + 1]}" in left for number in range(1, 24))


def test_whoever_wishes_sees_the_words_again_as_long_as_there_is_no_wallet(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    words = write_down(typed)
    typed.expect(r"Word number (\d+): ")
    number = typed.match[1]
    for _ in range(6):
        typed.sendline("?")
        assert write_down(typed) == words, "to look again is no wrong answer"
        typed.expect_exact(WIPED)
        typed.expect(f"Word number {number}: ")
    assert typed.ended_by_ctrl_c() == 1
    assert list(tmp_path.rglob("*.wallet")) == []


def test_a_terminal_that_cannot_wipe_gets_so_many_lines_that_no_word_is_left_on_it(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase", term="dumb")
    words = write_down(typed)
    typed.expect(rf"(?:\r?\n){{{ROWS + 1},}}")
    answer_check(typed, words)
    typed.expect(rf"(?:\r?\n){{{ROWS + 1},}}")
    assert typed.ended() == 0
    assert "\x1b" not in typed.rest()


@pytest.mark.smoke
def test_ctrl_c_while_the_words_stand_there_wipes_them_and_leaves_no_wallet(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    typed.expect("press Enter: ")
    typed.press_ctrl_c(re.escape(WIPED))
    typed.expect("Stopped. No wallet was made, and no file is left.")
    assert typed.ended() == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_ctrl_c_in_the_check_leaves_no_wallet(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    write_down(typed)
    typed.expect(r"Word number (\d+): ")
    typed.press_ctrl_c("Stopped. No wallet was made, and no file is left.")
    assert typed.ended() == 1
    assert "Aborted" not in typed.rest()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_ctrl_c_at_the_passphrase_leaves_no_wallet_and_no_words_and_says_so_in_portuguese(tmp_path: Path) -> None:
    words = tmp_path / "words.txt"
    typed = at_terminal(tmp_path, "--language", "pt", "new", "--words-file", str(words), "--fast-passphrase")
    typed.expect("Frase-passe: ")
    typed.press_ctrl_c("Interrompido. Não se fez nenhuma carteira")
    assert typed.ended() == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_ctrl_c_while_it_is_restored_says_that_there_is_no_wallet(tmp_path: Path) -> None:
    typed = at_terminal(tmp_path, "restore", "--fast-passphrase")
    typed.expect("The 24 words: ")
    typed.press_ctrl_c("Stopped. No wallet was made")
    assert typed.ended() == 1


def test_wrong_words_end_after_a_while_with_no_wallet(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    write_down(typed)
    for left in ("4 tries are", "3 tries are", "2 tries are", "1 try is"):
        typed.answer(r"Word number (\d+): ", "wrong")
        typed.expect(f"{left} left")
    typed.answer(r"Word number (\d+): ", "wrong")
    typed.expect_exact(WIPED)
    typed.expect("No wallet was made. The words that were shown are nobody's")
    typed.expect("WORDS_NOT_CHECKED. Next step: ")
    assert typed.ended() == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_weak_passphrase_is_told_why_and_asked_for_again(tmp_path: Path) -> None:
    typed = at_terminal(tmp_path, "new", "--fast-passphrase", "--no-check")
    typed.expect("Choose a passphrase: 15 letters or more")
    for passphrase, why in (("a", "1 letter, too short"), ("passwordpassword1", "made of what is tried first")):
        typed.answer("Passphrase: ", passphrase)
        typed.expect(why)
    typed.answer("Passphrase: ", "tea and lemon cake")
    typed.answer("once more: ", "tea and lemon cakes")
    typed.expect("two different ones")
    typed.choose_passphrase("tea and lemon cake")
    typed.expect("Taken. It is long enough")
    assert typed.ended() == 0


def test_five_weak_passphrases_are_enough(tmp_path: Path) -> None:
    typed = at_terminal(tmp_path, "--language", "pt", "new", "--fast-passphrase")
    for _ in range(5):
        typed.answer("Frase-passe: ", "chá")
        typed.expect("3 letras: curta demais")
    typed.expect("PASSPHRASE_WEAK. Próximo passo: Escolha uma mais comprida")
    assert typed.ended() == 4
    assert list(tmp_path.rglob("*.wallet")) == []


def test_of_two_that_make_a_wallet_at_one_place_the_second_is_refused_and_nothing_is_overwritten(
    tmp_path: Path,
) -> None:
    first = make(tmp_path, "new", "--fast-passphrase")
    words = write_down(first)
    (tmp_path / "words.txt").write_text(ABANDON)
    for arguments in (("new", "--no-check"), ("restore", "--words-file", str(tmp_path / "words.txt"))):
        second = at_terminal(tmp_path, *arguments, "--fast-passphrase")
        second.expect("WALLET_BUSY. Next step: ")
        assert second.ended() == 1
    answer_check(first, words)
    assert first.ended() == 0
    store = Keystore.open(tmp_path / "wallets" / "default.wallet", "tea and lemon cake")
    assert store.content.words == " ".join(words[number] for number in range(1, 25))


@pytest.mark.smoke
def test_no_check_asks_nothing_and_the_words_restore_the_wallet_in_portuguese(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase", "--no-check", language="pt")
    typed.expect("A sua carteira")
    words = words_shown(typed)
    assert typed.ended() == 0
    again = at_terminal(tmp_path, "--language", "pt", "--profile", "again", "restore", "--fast-passphrase")
    again.answer("As 24 palavras: ", " ".join(words[number] for number in range(1, 25)))
    again.choose_passphrase("tea and lemon cake")
    again.expect("blockrobot wallet --profile again records")
    assert again.ended() == 0


@pytest.mark.parametrize("words", ["abandon " * 24, "one two three", "abandon " * 23 + "árt", ""])
def test_wrong_words_are_refused_and_make_nothing(tmp_path: Path, words: str) -> None:
    file = tmp_path / "words.txt"
    file.write_text(words)
    typed = at_terminal(tmp_path, "restore", "--words-file", str(file), "--fast-passphrase")
    typed.expect("WORDS_INVALID. Next step: Check spelling")
    assert typed.ended() == 1
    assert list(tmp_path.rglob("*.wallet")) == []


def test_words_that_are_typed_wrong_are_asked_for_again(tmp_path: Path) -> None:
    right = "abandon " * 23 + "art"
    typed = at_terminal(tmp_path, "restore", "--fast-passphrase")
    for wrong, sentence in (("abandon " * 23, "There are 23 words"), ("zebro " + "abandon " * 23, "number 1.")):
        typed.answer("The 24 words: ", wrong)
        typed.expect(sentence)
    typed.answer("The 24 words: ", right)
    typed.choose_passphrase("tea and lemon cake")
    typed.expect("records")
    assert typed.ended() == 0


def test_new_words_of_a_change_are_wiped_too_and_ctrl_c_says_that_they_wait(home: Path) -> None:
    file = home / "wallets" / "default.wallet"
    store = Keystore.open(file, "tea and lemon cake")
    store.content.next_words = " ".join(["zoo"] * 23 + ["vote"])
    store.save()
    typed = at_terminal(home, "rotate")
    typed.answer("Passphrase: ", "tea and lemon cake")
    typed.expect("press Enter: ")
    assert WIPED in typed.before
    assert CONTROL.sub("", str(typed.before)).count("zoo") == 23
    typed.sendline("")
    typed.expect_exact(WIPED)
    typed.expect(r"Word number (\d+): ")
    typed.press_ctrl_c(re.escape(WIPED))
    typed.expect(
        "Stopped. Nothing is changed yet: your present words are in force. The next `blockrobot wallet rotate`"
    )
    assert typed.ended() == 1
    assert "Aborted" not in typed.rest()
    assert not Keystore.open(file, "tea and lemon cake").content.next_words_shown


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A home with a wallet of known words, and a genesis file that names nobody who listens."""
    (tmp_path / "words.txt").write_text(ABANDON)
    typed = make(tmp_path, "restore", "--words-file", str(tmp_path / "words.txt"), "--fast-passphrase")
    assert typed.ended() == 0
    from consensus.chain.genesis import genesis_to_json
    from tests.world.dicts import make_genesis

    (tmp_path / "network").mkdir()
    (tmp_path / "network" / "genesis.json").write_text(genesis_to_json(make_genesis()))
    return tmp_path


@pytest.mark.smoke
def test_a_wrong_passphrase_is_refused_with_its_own_exit_code(home: Path) -> None:
    typed = at_terminal(home, "records")
    typed.answer("Passphrase: ", "coffee")
    typed.expect("WALLET_PASSPHRASE_WRONG. Next step: Try again")
    assert typed.ended() == 4


def test_the_same_in_portuguese_and_without_utf8(home: Path) -> None:
    typed = at_terminal(home, "--language", "pt", "records", environment={"LC_ALL": "C"})
    typed.answer("Frase-passe: ", "coffee")
    typed.expect("A frase-passe nao abre esta carteira.")
    typed.expect("WALLET_PASSPHRASE_WRONG. Proximo passo: Tente outra vez")
    assert typed.ended() == 4


@pytest.mark.parametrize("place", [0, 40, -1])
def test_a_damaged_wallet_is_called_so_and_left_as_it_is(home: Path, place: int) -> None:
    file = home / "wallets" / "default.wallet"
    data = bytearray(file.read_bytes())
    data[place] ^= 0x55
    file.write_bytes(data)
    typed = at_terminal(home, "records")
    typed.answer("Passphrase: ", "tea and lemon cake")
    typed.expect("WALLET_DAMAGED. Next step: Restore the wallet from its 24 words")
    assert typed.ended() == 1
    assert file.read_bytes() == bytes(data)


def test_a_profile_that_is_not_there_is_not_found(home: Path) -> None:
    for command in ("records", "audit", "serve", "erasures"):
        typed = at_terminal(home, "--profile", "nobody", command)
        typed.expect(
            "WALLET_NOT_FOUND. Next step: Make one with `blockrobot wallet --profile nobody new`, or get yours back"
        )
        typed.expect("`blockrobot wallet --profile nobody restore`")
        typed.expect("`blockrobot wallet --profile nobody guardians recover`")
        assert typed.ended() == 3
    assert not any(path.name.startswith(".nobody") for path in home.rglob("*"))


def test_without_wallet_and_network_it_is_the_wallet_that_comes_first(tmp_path: Path) -> None:
    typed = at_terminal(tmp_path, "records")
    typed.expect(
        "Make one with `blockrobot wallet new`, or get yours back from its 24 words with `blockrobot wallet restore`"
    )
    assert typed.ended() == 3


def test_a_network_that_nobody_reaches_is_named_with_what_to_do(home: Path) -> None:
    typed = at_terminal(home, "records")
    typed.answer("Passphrase: ", "tea and lemon cake")
    typed.expect("NODE_UNREACHABLE. Next step: ")
    assert typed.ended() == 1
