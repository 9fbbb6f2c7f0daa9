"""Stepped padding, undone strictly."""

from __future__ import annotations

from bisect import bisect_left

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES

_LENGTH_BYTES = 4
_STEP_FIRST_BYTES = 1024
_STEP_GRAIN_BYTES = 64
_ENVELOPE_OVERHEAD_BYTES = 40  # nonce 24, tag 16
PADDED_MAX_BYTES = CIPHERTEXT_MAX_BYTES - _ENVELOPE_OVERHEAD_BYTES


def _compute_steps() -> tuple[int, ...]:
    steps = [_STEP_FIRST_BYTES]
    while steps[-1] < PADDED_MAX_BYTES:
        larger = -(-steps[-1] * 5 // (4 * _STEP_GRAIN_BYTES)) * _STEP_GRAIN_BYTES
        steps.append(min(larger, PADDED_MAX_BYTES))
    return tuple(steps)


PADDING_STEPS_BYTES = _compute_steps()


def pad(plaintext: bytes) -> bytes:
    """Pad to the smallest step. Raises UPLOAD_INVALID if too large."""
    place = bisect_left(PADDING_STEPS_BYTES, _LENGTH_BYTES + len(plaintext))
    if place == len(PADDING_STEPS_BYTES):
        raise BlockRobotError("UPLOAD_INVALID", f"A frame of {len(plaintext)} bytes is larger than a clip may hold.")
    return pad_to(plaintext, PADDING_STEPS_BYTES[place])


def unpad(padded: bytes) -> bytes:
    """Strictly undo `pad`. Raises ENVELOPE_INVALID."""
    place = bisect_left(PADDING_STEPS_BYTES, len(padded))
    if place == len(PADDING_STEPS_BYTES) or PADDING_STEPS_BYTES[place] != len(padded):
        raise BlockRobotError("ENVELOPE_INVALID", f"{len(padded)} bytes is no size of a padded text.")
    plaintext = unpad_from(padded)
    if place and _LENGTH_BYTES + len(plaintext) <= PADDING_STEPS_BYTES[place - 1]:
        raise BlockRobotError("ENVELOPE_INVALID", "A text is padded to a larger step than it needs.")
    return plaintext


def pad_to(plaintext: bytes, size_bytes: int) -> bytes:
    """Pad to exactly `size_bytes`. Raises UPLOAD_INVALID if too large."""
    filler = size_bytes - _LENGTH_BYTES - len(plaintext)
    if filler < 0:
        raise BlockRobotError("UPLOAD_INVALID", f"{len(plaintext)} bytes do not fit into {size_bytes}.")
    return len(plaintext).to_bytes(_LENGTH_BYTES, "big") + plaintext + bytes(filler)


def unpad_from(padded: bytes) -> bytes:
    """Undo `pad_to`. Raises ENVELOPE_INVALID for wrong length or filler."""
    end = _LENGTH_BYTES + int.from_bytes(padded[:_LENGTH_BYTES], "big")
    if len(padded) < _LENGTH_BYTES or end > len(padded) or padded[end:].strip(b"\x00"):
        raise BlockRobotError("ENVELOPE_INVALID", "The padding of a text is damaged.")
    return padded[_LENGTH_BYTES:end]
