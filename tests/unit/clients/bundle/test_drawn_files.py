"""A drawn picture may be packed by another program's PNG encoder: equal pixels are equal, and nothing else is."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from clients.bundle.checks.frame_check import Piece, is_same_file
from clients.sdk.pictures.rendition_picture import encode_depth_png

PIXELS = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
DEPTH = np.arange(6 * 8, dtype=np.uint16).reshape(6, 8)


def packed(image: np.ndarray, level: int) -> bytes:
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])
    assert done
    return data.tobytes()


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


PICTURE = Piece("pictures/0001/00001-00.png", packed(PIXELS, 3), is_drawn=True)


def test_another_compression_of_the_same_pixels_is_the_same_picture() -> None:
    other = packed(PIXELS, 9)
    assert other != PICTURE.content
    assert is_same_file(PICTURE, other)
    depth = Piece("depth/0001/00001-00.depth.png", encode_depth_png(DEPTH), is_drawn=True)
    assert is_same_file(depth, packed(DEPTH, 9))


def test_one_pixel_makes_another_picture() -> None:
    pixels = PIXELS.copy()
    pixels[2, 3, 1] ^= 1
    assert not is_same_file(PICTURE, packed(pixels, 3))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda png: png[:-12] + chunk(b"tEXt", b"Comment\0written between the lines") + png[-12:],
        lambda png: png + b"behind",
        lambda png: png[:-12],
        lambda png: png[:8] + chunk(b"IEND", b"") + png[8:],
        lambda png: b"",
        lambda png: b"\xff\xd8\xff\xd9",
        lambda png: png[:8] + struct.pack(">I", 0xFFFFFFF0) + png[12:],
    ],
)
def test_nothing_is_written_between_the_lines(spoil) -> None:
    assert not is_same_file(PICTURE, spoil(packed(PIXELS, 9)))


def test_grey_for_colour_and_another_size_are_other_pictures() -> None:
    assert not is_same_file(PICTURE, encode_depth_png(DEPTH))
    assert not is_same_file(PICTURE, packed(PIXELS[:4], 3))


def test_committed_bytes_have_one_form_only() -> None:
    committed = Piece("backgrounds/aa.png", packed(PIXELS, 3), is_drawn=False)
    assert is_same_file(committed, committed.content)
    assert not is_same_file(committed, packed(PIXELS, 9))
