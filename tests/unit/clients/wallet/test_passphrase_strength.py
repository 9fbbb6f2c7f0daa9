"""Which new passphrases are taken: by length and by what is common, never by the kinds of letters."""

from __future__ import annotations

import pytest

from clients.wallet.passphrase_strength import Strength, count_parts, judge_passphrase
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
        " " * 20,
        "123456789012345",
        "1234567890" * 12,
        "passwordpassword",
        "Password Password 123",
        "p a s s w o r d p a s s w o r d",
        "qwertyuiopasdfghjkl",
        "poiuytrewqlkjhgfdsa",
        "abcdefghijklmnopqrstuvwxyz",
        "iloveyouiloveyou1",
        "correct horse battery staple",
        "carteira-blockrobot",
        "senhasenhasenha123",
        "abcabcabcabcabcabc",
        "PASSWORD_PASSWORD_20",
        "----------------",
    ],
)
def test_a_long_one_of_what_is_tried_first_is_refused(passphrase: str) -> None:
    with pytest.raises(BlockRobotError, match="tried first"):
        judge_passphrase(passphrase)


@pytest.mark.parametrize(
    ("passphrase", "strength"),
    [
        ("tea and lemon cake", Strength.GOOD),
        ("maria come laranjas", Strength.FAIR),
        ("kettle orbit maple saddle", Strength.STRONG),
        ("chaleira órbita bordo sela", Strength.STRONG),
        ("夏草や兵どもが夢の跡古池や蛙飛", Strength.GOOD),
        ("nQ8v-7Jr2kLp0xZ4Yb", Strength.GOOD),
    ],
)
def test_a_long_one_of_ones_own_is_taken_in_any_script(passphrase: str, strength: Strength) -> None:
    assert judge_passphrase(passphrase) is strength


def test_one_more_of_the_same_makes_none_stronger() -> None:
    assert count_parts("kettle" * 20) == count_parts("kettlekettlekettle") == 7


def test_one_of_many_thousand_letters_is_taken_in_no_time() -> None:
    assert judge_passphrase("".join(chr(0x4E00 + number % 5000) for number in range(100_000))) is Strength.STRONG
