"""Padding over any text: it comes back, in few sizes, and one padded form is all there is."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.records.padding import PADDING_STEPS_BYTES, pad, unpad

TEXTS = st.one_of(st.binary(max_size=3000), st.integers(0, 200_000).map(lambda size: b"\xab" * size))


@given(TEXTS)
def test_a_text_comes_back_and_its_size_is_a_step(text: bytes) -> None:
    padded = pad(text)
    assert unpad(padded) == text
    assert len(padded) in PADDING_STEPS_BYTES
    assert len(padded) <= max(1024, (len(text) + 4) * 1.32)


@given(st.binary(max_size=2000), st.data())
def test_whatever_opens_is_what_padding_makes(text: bytes, data: st.DataObject) -> None:
    changed = bytearray(pad(text))
    changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        opened = unpad(bytes(changed))
    except BlockRobotError as error:
        assert error.code == "ENVELOPE_INVALID"  # noqa: PT017 - both outcomes are right, each with its own check
    else:
        assert pad(opened) == changed


@given(st.binary(max_size=1500))
def test_bytes_that_are_no_padded_text_never_open_to_two_forms(noise: bytes) -> None:
    if len(noise) not in PADDING_STEPS_BYTES:
        with pytest.raises(BlockRobotError):
            unpad(noise)
    else:
        assert unpad(pad(noise)) == noise
