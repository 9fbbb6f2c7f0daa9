"""Four keys from 24 words: always the same ones, for ever."""

from __future__ import annotations

import pytest

from clients.wallet.store.member_keys import WORDS_COUNT, derive_keys, draw_words
from consensus.errors import BlockRobotError

# The published BIP-39 test vector for 32 bytes of zero, so that nobody takes these for real.
WORDS = "abandon " * 23 + "art"
GOLDEN = {
    "identity": "0308c8dbbbe5818372b07a1e96b0cf4cfc6966dc6acaa5c3b1fa372edf2ac640c9",
    "spend": "032710aaaca2d0b2bf89d1c030e5959a37f213befb4884f269b850fba283d55fcf",
    "view": "031ba05c1b82f2a4d8ae66b570faa3ee8a4e5e9ba464aa8d220db18964d352663b",
    "sealing": "101ac45081e5f04023d2e1ccf0f37fa0a7d6a856b8d58ba985c37ed9732c2e0d",
}


def test_the_keys_of_24_words_never_change() -> None:
    """Whoever restores a wallet in ten years must find the visits of today."""
    keys = derive_keys(WORDS)
    assert {
        "identity": keys.identity.public_key.hex(),
        "spend": keys.spend.public_key.hex(),
        "view": keys.view.public_key.hex(),
        "sealing": keys.sealing_public.hex(),
    } == GOLDEN


def test_the_four_keys_differ() -> None:
    keys = derive_keys(WORDS)
    assert len({keys.identity.secret, keys.spend.secret, keys.view.secret, keys.sealing}) == 4


def test_words_are_read_as_people_write_them() -> None:
    assert derive_keys("  " + WORDS.upper().replace(" ", "\n ") + "\n").sealing == derive_keys(WORDS).sealing


def test_drawn_words_make_a_wallet_and_are_never_the_same() -> None:
    first, second = draw_words(), draw_words()
    assert len(first.split()) == WORDS_COUNT
    assert first != second
    assert derive_keys(first).identity.public_key != derive_keys(second).identity.public_key


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("", "There are 0 words"),
        ("abandon", "There is 1 word,"),
        ("abandon " * 11 + "about", "There are 12 words"),
        (WORDS + " art", "There are 25 words"),
        (WORDS.replace("art", "arts"), "such words: number 24."),
        ("zebro " + "abandon " * 22 + "árt", "such words: number 1, 24."),
        ("abandon " * 24, "together they are none"),
    ],
)
def test_words_with_a_slip_are_refused_and_named_by_their_numbers_alone(words: str, sentence: str) -> None:
    with pytest.raises(BlockRobotError) as caught:
        derive_keys(words)
    assert caught.value.code == "WORDS_INVALID"
    assert sentence in caught.value.detail
    assert not any(word in caught.value.detail for word in ("abandon", "zebro", "arts"))


def test_no_secret_shows_when_keys_are_printed() -> None:
    keys = derive_keys(WORDS)
    for shown in (repr(keys), str(keys), f"{keys}", repr(keys.identity)):
        for secret in (keys.identity.secret, keys.spend.secret, keys.view.secret, keys.sealing):
            assert secret.hex() not in shown
            assert repr(secret) not in shown
