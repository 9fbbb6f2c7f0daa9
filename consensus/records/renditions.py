"""A rendition frame: the owner's pixels and their recorded empty frame."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.records.metadata import MOMENT_MAX_MS

RENDITION_VERSION = 1
ENCODING_PNG16 = "png16"
ENCODING_PNG_RGBA = "png-rgba"
ENCODING_JPEG = "jpeg"
ENCODING_LABEL = "label"
ENCODING_WAV = "wav"
PICTURES = (ENCODING_PNG16, ENCODING_PNG_RGBA, ENCODING_JPEG)
BOXLESS = (ENCODING_LABEL, ENCODING_WAV)
PICTURE_SIDE_MAX_PIXELS = 8192
NO_BACKGROUND = bytes(HASH_SIZE_BYTES)
"""In place of an empty frame's hash: the owner is shown on nothing, or it is no depth picture."""


class Rendition(Wire, frozen=True):
    """One frame as its owner may see it; times are the robot's wall clock.

    Fields as in docs/reference/formats.md; `background_id` is `NO_BACKGROUND` where the robot drove, and for other
    senses.
    """

    version: int
    captured_at_ms: int
    sequence: int
    width: int
    height: int
    x: int
    y: int
    box_width: int
    box_height: int
    background_id: bytes
    encoding: str
    pixels: bytes


def encode_rendition(rendition: Rendition) -> bytes:
    return encode(rendition)


def decode_rendition(plaintext: bytes) -> Rendition:
    """Decode; check box and time. Raises RENDITION_CORRUPTED."""
    try:
        rendition = decode(plaintext, Rendition)
    except BlockRobotError as error:
        raise BlockRobotError("RENDITION_CORRUPTED", error.detail) from None
    inside = (
        0 < rendition.width <= PICTURE_SIDE_MAX_PIXELS
        and 0 < rendition.height <= PICTURE_SIDE_MAX_PIXELS
        and rendition.x >= 0
        and rendition.y >= 0
        and rendition.box_width >= 0
        and rendition.box_height >= 0
        and rendition.x + rendition.box_width <= rendition.width
        and rendition.y + rendition.box_height <= rendition.height
    )
    shown = 0 <= rendition.captured_at_ms < MOMENT_MAX_MS
    known = rendition.encoding in PICTURES or (rendition.encoding in BOXLESS and not rendition.box_width)
    if not inside or not shown or rendition.version != RENDITION_VERSION or not known:
        raise BlockRobotError(
            "RENDITION_CORRUPTED", "The rendition's box, time or version is not one this wallet knows."
        )
    return rendition
