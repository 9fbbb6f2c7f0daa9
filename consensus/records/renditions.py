"""A rendition's frame as it is sealed: its owner's pixels, and which recorded empty frame they stand on."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
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


class Rendition(Wire, frozen=True):
    """One frame as its owner may see it.

    `pixels` is a PNG of 16 bits (millimetres) of the box at (x, y) with box_width x box_height pixels, 0 where a pixel
    is not the owner's. `width` x `height` is the whole frame. A box of no pixels: withheld, nothing to show.
    `background_id` is the SHA-256 of the empty frame's PNG bytes. Times are the robot's wall clock.

    Other senses have no background (32 zero bytes) and other encodings: `png-rgba`, the owner's colour pixels of the
    box, transparent where they are not hers; `jpeg`, a whole colour image on which only she is; `label`, an object of
    JSON with `label` and perhaps `confidence`; `wav`, a sound file. The last two have a frame of 1 x 1 and no box.
    Without any bytes in `pixels`, whatever the encoding, there is nothing to show.
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
    """Return the plaintext that is committed to, padded and sealed."""
    return encode(rendition)


def decode_rendition(plaintext: bytes) -> Rendition:
    """Read a rendition and check that its box lies in its frame, and its time in a calendar. Raises RENDITION_CORRUPTED."""
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
