"""Short handles: each comes back, and a slip of the pen or the ear is found."""

from __future__ import annotations

import secrets

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.members.handles import (
    _BECH32M,
    _LETTERS,
    SHORT_HANDLE_BYTES,
    _polymod,
    decode_short,
    encode_short,
    is_short,
)

handles = st.binary(min_size=32, max_size=32)


def refuses(text: str) -> bool:
    try:
        decode_short(text)
    except BlockRobotError as error:
        return error.code == "HANDLE_MISTYPED"
    return False


@pytest.mark.parametrize(
    "valid",
    [
        "a1lqfn3a",
        "abcdef1l7aum6echk45nj3s0wdvt2fg8x9yrzpqzd3ryx",
        "split1checkupstagehandshakeupstreamerranterredcaperredlc445v",
    ],
)
def test_the_checksum_is_that_of_bip_350(valid: str) -> None:
    """Vectors of BIP-350."""
    name, _, letters = valid.rpartition("1")
    expanded = [ord(each) >> 5 for each in name] + [0] + [ord(each) & 31 for each in name]
    assert _polymod(expanded + [_LETTERS.index(each) for each in letters]) == _BECH32M


@given(handles)
def test_every_handle_comes_back_however_it_is_written(handle: bytes) -> None:
    short = encode_short(handle)
    assert is_short(short)
    assert len(short) == 31
    for written in (short, short.upper(), short.replace("-", ""), short.replace("-", " "), f" {short}\n"):
        assert decode_short(written) == handle[:SHORT_HANDLE_BYTES]


def test_every_change_of_one_character_is_found() -> None:
    plain = encode_short(secrets.token_bytes(32)).replace("-", "")
    for place in range(len("brh1"), len(plain)):
        for letter in "abcdefghijklmnopqrstuvwxyz0123456789":
            changed = plain[:place] + letter + plain[place + 1 :]
            assert changed == plain or refuses(changed), changed


@given(handles, st.data())
def test_changes_of_up_to_four_characters_are_found(handle: bytes, data: st.DataObject) -> None:
    letters = list(encode_short(handle).replace("-", ""))
    places = data.draw(st.sets(st.integers(4, len(letters) - 1), min_size=1, max_size=4))
    for place in places:
        letters[place] = data.draw(st.sampled_from([each for each in _LETTERS if each != letters[place]]))
    assert refuses("".join(letters))


@given(handles, st.integers(4, 24))
def test_two_neighbours_in_the_wrong_order_are_found(handle: bytes, place: int) -> None:
    plain = encode_short(handle).replace("-", "")
    swapped = plain[:place] + plain[place + 1] + plain[place] + plain[place + 2 :]
    assert swapped == plain or refuses(swapped)


@given(st.text(max_size=40))
def test_other_texts_are_refused(text: str) -> None:
    assert refuses(text)


@given(handles, st.integers(4, 25))
def test_a_letter_too_few_or_too_many_is_found(handle: bytes, place: int) -> None:
    plain = encode_short(handle).replace("-", "")
    assert refuses(plain[:place] + plain[place + 1 :])
    assert refuses(plain[:place] + "q" + plain[place:])
