"""Pictures from renditions: whole ones come out exactly, anything else is refused before it is shown."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.sdk.pictures.picture_guard import PNG_SIGNATURE
from clients.sdk.pictures.rendition_picture import colourise, compose_on, decode_depth_png, encode_depth_png
from consensus.errors import BlockRobotError

EMPTY = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) + 1_000
OWNER = np.array([[0, 5_000, 0], [5_001, 5_002, 5_003]], dtype=np.uint16)


def test_the_owner_stands_in_the_empty_frame_and_nothing_else_changes() -> None:
    picture = compose_on(EMPTY, 10, 20, 3, 2, encode_depth_png(OWNER))
    expected = EMPTY.copy()
    expected[20, 11] = 5_000
    expected[21, 10:13] = (5_001, 5_002, 5_003)
    assert np.array_equal(picture, expected)


@pytest.mark.parametrize(("x", "y", "width", "height"), [(62, 0, 3, 2), (0, 47, 3, 2), (-1, 0, 3, 2), (0, 0, 2, 3)])
def test_a_box_that_does_not_fit_is_corrupted(x: int, y: int, width: int, height: int) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        compose_on(EMPTY, x, y, width, height, encode_depth_png(OWNER))


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_any_changed_byte_of_a_png_is_noticed(place: int, change: int) -> None:
    png = bytearray(encode_depth_png(EMPTY))
    png[place % len(png)] ^= change
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_depth_png(bytes(png))


@given(st.integers(0, 5_000))
def test_any_truncated_png_is_noticed(length: int) -> None:
    png = encode_depth_png(EMPTY)
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_depth_png(png[: length % len(png)])


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(width: int, height: int, bits: int, pixels: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return PNG_SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(pixels)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    "png",
    [
        png_of(100_000, 100_000, 16, b"\0"),
        png_of(0, 4, 16, b""),
        png_of(4, 4, 8, b"\0" * 20),
        png_of(4, 4, 16, b"\0" * 35),
        png_of(4, 4, 16, b"\0" * 37),
        png_of(4, 4, 16, b"\0" * 36) + b"tail",
        PNG_SIGNATURE + chunk(b"IEND", b""),
        b"",
        b"GIF89a",
    ],
)
def test_what_is_no_whole_depth_picture_is_refused(png: bytes) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_depth_png(png)


def test_a_handmade_png_is_read() -> None:
    assert decode_depth_png(png_of(2, 1, 16, b"\0\x01\x02\x03\x04")).tolist() == [[0x0102, 0x0304]]


def test_colours_tell_near_from_far_and_unmeasured_is_grey() -> None:
    depth = np.full((60, 320), 1_000, np.uint16)
    depth[:, 100:200], depth[:, 200:] = 7_500, 0
    image = cv2.imdecode(np.frombuffer(colourise(depth), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (104, 320, 3)
    assert int(image[30, 50].sum()) > int(image[30, 150].sum()), "near is bright, far is dark"
    assert len({int(v) for v in image[30, 250]}) == 1
    plain = cv2.imdecode(np.frombuffer(colourise(depth, legend=False), np.uint8), cv2.IMREAD_COLOR)
    assert plain is not None
    assert plain.shape == (60, 320, 3)


def test_only_depth_can_be_written_as_depth() -> None:
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        encode_depth_png(np.zeros((4, 4), np.uint8))  # type: ignore[arg-type]
