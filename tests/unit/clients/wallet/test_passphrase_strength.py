"""Which new passphrases are taken: by length and by what is common, never by the kinds of letters."""

from __future__ import annotations

import re

import pytest

from clients.wallet.presentation.translations import LANGUAGES, text
from clients.wallet.store.passphrase_strength import Strength, judge_passphrase
from consensus.errors import BlockRobotError


@pytest.mark.parametrize("passphrase", ["", "a", "tea", "P4$$w0rd!", "x" * 5, "olá e bom dia", "14 letters, no"])
def test_a_short_one_is_refused_whatever_its_letters(passphrase: str) -> None:
    with pytest.raises(BlockRobotError, match="15 is the least") as refused:
        judge_passphrase(passphrase)
    assert refused.value.code == "PASSPHRASE_WEAK"
    assert not passphrase or passphrase not in refused.value.detail.split()


@pytest.mark.parametrize(
    "passphrase",
    [
        "a" * 15,
        "1234567890" * 12,
        "passwordpassword",
        "Password Password 123",
        "p a s s w o r d p a s s w o r d",
        "qwertyuiopasdfghjkl",
        "correct horse battery staple",
        "carteira-blockrobot",
        "senhasenhasenha123",
        "P@ssw0rdP@ssw0rd1",
        "5un5h1n3-pr1nc3$$",
        "----------------",
        "kettle" * 20,
        "$3nh@ $3nh@ $3nh@",
        "hospital wallet robot card",
        "summer winter spring autumn",
        "monkey dragon football hockey",
        "Password1!Password2!",
        "passphrase wallet robot hospital patient",
    ],
)
def test_a_long_one_of_what_is_tried_first_is_refused(passphrase: str) -> None:
    with pytest.raises(BlockRobotError, match="tried first"):
        judge_passphrase(passphrase)


@pytest.mark.parametrize(
    ("passphrase", "strength"),
    [
        ("tea and lemon cake", Strength.FAIR),
        ("maria come laranjas verdes", Strength.FAIR),
        ("kettle orbit maple saddle", Strength.LONG),
        ("chaleira órbita bordo sela", Strength.LONG),
        ("夏草や兵どもが夢の跡古池や蛙飛", Strength.LONG),
        ("nQ8v-7Jr2kLp0xZ4Yb", Strength.LONG),
    ],
)
def test_a_long_one_of_ones_own_is_taken_in_any_script(passphrase: str, strength: Strength) -> None:
    assert judge_passphrase(passphrase) is strength


def test_one_of_many_thousand_letters_is_taken_in_no_time() -> None:
    letters = [chr(0x4E00 + number * 7919 % 5000) for number in range(100_000)]
    assert judge_passphrase("".join(letters)) is Strength.LONG


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("strength", list(Strength))
def test_what_is_taken_is_not_praised_for_what_nobody_here_can_know(strength: Strength, language: str) -> None:
    said = text(f"passphrase.{strength.value}", language=language)
    assert not set(re.findall(r"\w+", said.casefold())) & {"good", "strong", "safe", "boa", "forte", "segura"}
