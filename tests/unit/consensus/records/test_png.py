"""An empty frame is a depth picture and nothing else: whatever else a file can hold is refused, before it is unpacked."""

from __future__ import annotations

import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.records.png import check_depth_png, most_parts

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def picture(
    width: int = 3, height: int = 2, pixels: bytes | None = None, header: bytes = b"\x10\x00\x00\x00\x00"
) -> bytes:
    rows = bytes(height * (1 + 2 * width)) if pixels is None else pixels
    parts = chunk(b"IHDR", struct.pack(">II", width, height) + header) + chunk(b"IDAT", zlib.compress(rows))
    return SIGNATURE + parts + chunk(b"IEND", b"")


@pytest.mark.parametrize("shape", [(1, 1), (480, 640), (7, 4096)])
@pytest.mark.parametrize("level", [0, 1, 9])
def test_what_the_robot_writes_is_a_depth_picture(shape: tuple[int, int], level: int) -> None:
    depth = np.random.default_rng(1).integers(0, 9_000, shape, dtype=np.uint16)
    done, data = cv2.imencode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, level])
    assert done
    assert check_depth_png(data.tobytes()) == (shape[1], shape[0])


GOOD = picture()
WRONG = {
    "empty": b"",
    "text": b"an empty corridor",
    "only the signature": SIGNATURE,
    "a hidden part": GOOD[:-12] + chunk(b"tEXt", b"a name") + GOOD[-12:],
    "bytes behind the end": GOOD + b"more",
    "a second picture behind it": GOOD + GOOD,
    "cut off": GOOD[:-5],
    "a damaged part": GOOD[:40] + bytes([GOOD[40] ^ 1]) + GOOD[41:],
    "a damaged checksum": GOOD[:32] + bytes([GOOD[32] ^ 1]) + GOOD[33:],
    "8 bits": picture(header=b"\x08\x00\x00\x00\x00"),
    "colour": picture(header=b"\x10\x02\x00\x00\x00"),
    "interlaced": picture(header=b"\x10\x00\x00\x00\x01"),
    "no width": picture(width=0, pixels=bytes(2)),
    "too wide": picture(width=4097, height=1),
    "too few pixels": picture(pixels=bytes(13)),
    "too many pixels": picture(pixels=bytes(15)),
    "an unknown filter": picture(pixels=b"\x05" + bytes(13)),
    "a short header": SIGNATURE + chunk(b"IHDR", b"\x00") + chunk(b"IDAT", b"") + chunk(b"IEND", b""),
    "no pixels": SIGNATURE + GOOD[8:33] + chunk(b"IEND", b""),
    "hidden behind the pixels": SIGNATURE
    + GOOD[8:33]
    + chunk(b"IDAT", zlib.compress(bytes(14)) + b"hidden")
    + chunk(b"IEND", b""),
    "pixels that are none": SIGNATURE + GOOD[8:33] + chunk(b"IDAT", b"\xff" * 20) + chunk(b"IEND", b""),
}


@pytest.mark.parametrize("content", WRONG.values(), ids=WRONG)
def test_anything_else_is_refused(content: bytes) -> None:
    with pytest.raises(BlockRobotError, match="BACKGROUND_NOT_A_PICTURE"):
        check_depth_png(content)


def test_the_smallest_parts_at_the_largest_size_are_not_walked() -> None:
    """Each costs its reader the same, however little is in it: 40 to 110 times an honest picture of the size."""
    empty = chunk(b"IDAT", b"")
    with pytest.raises(BlockRobotError, match="in more parts"):
        check_depth_png(GOOD[:33] + empty * (16 * 1024 * 1024 // len(empty)) + GOOD[33:])
    assert check_depth_png(GOOD[:33] + empty * 50 + GOOD[33:]) == (3, 2)


@pytest.mark.parametrize("level", [0, 1])
def test_an_encoder_writes_far_fewer_parts_than_there_may_be(level: int) -> None:
    depth = np.random.default_rng(1).integers(0, 65_535, (1_024, 2_048), dtype=np.uint16)
    data = cv2.imencode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()
    assert data.count(b"IDAT") <= most_parts(len(data)) // 4


def test_a_bomb_is_not_unpacked() -> None:
    bomb = picture(pixels=bytes(200_000_000))
    assert len(bomb) < 300_000
    tracemalloc.start()
    try:
        with pytest.raises(BlockRobotError, match="BACKGROUND_NOT_A_PICTURE"):
            check_depth_png(bomb)
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


@given(st.integers(0, len(GOOD) - 1), st.binary(min_size=0, max_size=3))
def test_a_changed_file_is_a_picture_or_refused(place: int, change: bytes) -> None:
    content = GOOD[:place] + change + GOOD[place + len(change) :]
    try:
        assert check_depth_png(content) == (3, 2)
    except BlockRobotError as error:
        assert error.code == "BACKGROUND_NOT_A_PICTURE"  # noqa: PT017 - both outcomes are right
