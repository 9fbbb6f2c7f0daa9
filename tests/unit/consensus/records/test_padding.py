"""Padding: the steps themselves, and what unpadding refuses."""

from __future__ import annotations

from itertools import pairwise

import pytest

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES
from consensus.records.padding import PADDED_MAX_BYTES, PADDING_STEPS_BYTES, pad, pad_to, unpad, unpad_from


def refusal_of(padded: bytes) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        unpad(padded)
    return refusal.value.code


def test_each_step_is_about_a_quarter_larger_than_the_one_before() -> None:
    assert PADDING_STEPS_BYTES[0] == 1024
    assert PADDING_STEPS_BYTES[-1] == PADDED_MAX_BYTES == CIPHERTEXT_MAX_BYTES - 40
    for smaller, larger in pairwise(PADDING_STEPS_BYTES[:-1]):
        assert 1.25 <= larger / smaller < 1.32


def test_a_text_takes_the_smallest_step_that_fits_and_none_above_the_largest() -> None:
    for smaller, larger in pairwise(PADDING_STEPS_BYTES):
        assert len(pad(bytes(smaller - 4))) == smaller
        assert len(pad(bytes(smaller - 3))) == larger
    assert len(pad(bytes(PADDED_MAX_BYTES - 4))) == PADDED_MAX_BYTES
    with pytest.raises(BlockRobotError, match=r"^UPLOAD_INVALID:"):
        pad(bytes(PADDED_MAX_BYTES - 3))


@pytest.mark.parametrize("size", [0, 3, 1023, 1025, PADDED_MAX_BYTES + 1])
def test_only_steps_are_sizes_of_padded_texts(size: int) -> None:
    assert refusal_of(bytes(size)) == "ENVELOPE_INVALID"


def test_padding_of_another_step_filler_or_length_is_refused() -> None:
    assert refusal_of(pad_to(b"short", PADDING_STEPS_BYTES[1])) == "ENVELOPE_INVALID"
    assert refusal_of(pad(b"text")[:-1] + b"\x01") == "ENVELOPE_INVALID"
    assert refusal_of(b"\xff" * 4 + bytes(1020)) == "ENVELOPE_INVALID"
    assert refusal_of((1021).to_bytes(4, "big") + bytes(1020)) == "ENVELOPE_INVALID"


def test_a_fixed_size_is_kept_or_refused() -> None:
    assert unpad_from(pad_to(b"metadata", 512)) == b"metadata"
    assert len(pad_to(bytes(508), 512)) == 512
    with pytest.raises(BlockRobotError, match=r"^UPLOAD_INVALID:"):
        pad_to(bytes(509), 512)
