"""A wallet made, restored and misused at a terminal, as a person types it. No network is there.

The commands run in a process of their own, behind a pseudo-terminal.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.ui.typed import CONTROL, Typed, at_terminal

ABANDON = " ".join(["abandon"] * 23 + ["art"])


def make(home: Path, *arguments: str, language: str = "en", **terminal: object) -> Typed:
    typed = at_terminal(home, "--language", language, *arguments, **terminal)  # type: ignore[arg-type]
    for _ in range(2):
        typed.expect("(?i)(pass|frase)[^:]*: ")
        typed.sendline("tea")
    return typed


def words_shown(typed: Typed) -> dict[int, str]:
    shown = CONTROL.sub("", str(typed.before))
    return {int(number): word for number, word in re.findall(r"(\d+) ([a-z]+)", shown)}


@pytest.mark.parametrize("columns", [24, 40, 100])
def test_new_asks_three_words_back_until_they_are_right(tmp_path: Path, columns: int) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase", columns=columns)
    typed.expect("(?s)To see that")
    words = words_shown(typed)
    assert sorted(words) == list(range(1, 25))
    typed.expect(r"Word number (\d+): ")
    typed.sendline("wrong")
    typed.expect("Look again")
    for _ in range(3):
        typed.expect(r"Word number (\d+): ")
        assert not (tmp_path / "wallets" / "default.wallet").exists(), "first the words, then the wallet"
        typed.sendline(words[int(typed.match[1])])
    assert typed.ended() == 0
    assert (tmp_path / "wallets" / "default.wallet").stat().st_mode & 0o777 == 0o600


def test_ctrl_c_in_the_check_leaves_no_wallet(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase")
    typed.expect(r"Word number (\d+): ")
    typed.sendintr()
    assert typed.ended() == 1
    assert list(tmp_path.rglob("*.wallet")) == []


def test_no_check_asks_nothing_and_the_words_restore_the_wallet_in_portuguese(tmp_path: Path) -> None:
    typed = make(tmp_path, "new", "--fast-passphrase", "--no-check", language="pt")
    typed.expect("A sua carteira")
    words = words_shown(typed)
    assert typed.ended() == 0
    again = at_terminal(tmp_path, "--language", "pt", "--profile", "again", "restore", "--fast-passphrase")
    again.expect("As 24 palavras: ")
    again.sendline(" ".join(words[number] for number in range(1, 25)))
    for _ in range(2):
        again.expect("(?i)frase[^:]*: ")
        again.sendline("tea")
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


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A home with a wallet of known words, and a genesis file that names nobody who listens."""
    (tmp_path / "words.txt").write_text(ABANDON)
    typed = make(tmp_path, "restore", "--words-file", str(tmp_path / "words.txt"), "--fast-passphrase")
    assert typed.ended() == 0
    from consensus.genesis import genesis_to_json
    from tests.unit.clients.wallet.conftest import make_genesis

    (tmp_path / "network").mkdir()
    (tmp_path / "network" / "genesis.json").write_text(genesis_to_json(make_genesis()))
    return tmp_path


def test_a_wrong_passphrase_is_refused_with_its_own_exit_code(home: Path) -> None:
    typed = at_terminal(home, "records")
    typed.expect("Passphrase: ")
    typed.sendline("coffee")
    typed.expect("WALLET_PASSPHRASE_WRONG. Next step: Try again")
    assert typed.ended() == 4


def test_the_same_in_portuguese_and_without_utf8(home: Path) -> None:
    typed = at_terminal(home, "--language", "pt", "records", environment={"LC_ALL": "C"})
    typed.expect("Frase-passe: ")
    typed.sendline("coffee")
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
    typed.expect("Passphrase: ")
    typed.sendline("tea")
    typed.expect("WALLET_DAMAGED. Next step: Restore the wallet from its 24 words")
    assert typed.ended() == 1
    assert file.read_bytes() == bytes(data)


def test_a_profile_that_is_not_there_is_not_found(home: Path) -> None:
    typed = at_terminal(home, "--profile", "nobody", "records")
    typed.expect("Passphrase: ")
    typed.sendline("tea")
    typed.expect("WALLET_NOT_FOUND. Next step: Make one with `blockrobot wallet new`")
    assert typed.ended() == 3


def test_a_network_that_nobody_reaches_is_named_with_what_to_do(home: Path) -> None:
    typed = at_terminal(home, "records")
    typed.expect("Passphrase: ")
    typed.sendline("tea")
    typed.expect("NODE_UNREACHABLE. Next step: ")
    assert typed.ended() == 1
