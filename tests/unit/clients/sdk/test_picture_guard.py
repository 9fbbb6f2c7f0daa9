"""Picture files that ask for more than their pixels: no decoder of the robot or the wallet is given them as they are."""

from __future__ import annotations

import resource
import struct
import time
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from clients.robot.sources.messages.image_decoding import DEPTH_HEADER_BYTES, decode_colour_file, decode_depth
from clients.sdk.pictures.picture_guard import (
    JPEG_SCANS_MAX_COUNT,
    PNG_SIGNATURE,
    has_few_scans,
    jpeg_size,
    keep_pixels,
)
from clients.sdk.pictures.rendition_picture import check_jpeg, decode_depth_png
from clients.sdk.terminal.qr_codes import read_qr
from consensus.errors import BlockRobotError

DEPTH = np.full((4, 6), 1500, np.uint16)
PNG = bytes(cv2.imencode(".png", DEPTH)[1])
HEADER, REST = PNG[:33], PNG[33:]
CPU_MAX_S, MEMORY_MAX_KB = 1.0, 200_000
SIDE_PX = 2_048


def chunk(kind: bytes, body: bytes, length: int | None = None) -> bytes:
    size = struct.pack(">I", len(body) if length is None else length)
    return size + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def progressive(scans: int) -> bytes:
    """A picture of one colour, its last scan repeated."""
    grey = np.full((SIDE_PX, SIDE_PX, 3), 90, np.uint8)
    data = bytes(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1])
    last = data.rindex(b"\xff\xda")
    return data[:-2] + data[last:-2] * (scans - data.count(b"\xff\xda")) + data[-2:]


@pytest.fixture
def bounded():
    """What a test does costs little."""
    began_s, before_kb = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.process_time() - began_s < CPU_MAX_S
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < MEMORY_MAX_KB


def test_the_smallest_parts_at_the_largest_size_are_not_walked() -> None:
    """A file of 16 MiB may be a million parts; none is passed on, and no more of them looked at than encoders write."""
    empty, comment = chunk(b"IDAT", b""), b"\xff\xfe\x00\x02"
    jpeg = bytes(cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1])
    assert keep_pixels(HEADER + empty * (16 * 1024 * 1024 // len(empty)) + REST) is None
    assert jpeg_size(jpeg[:2] + comment * (16 * 1024 * 1024 // len(comment)) + jpeg[2:]) is None
    assert keep_pixels(HEADER + empty * 50 + REST) is not None
    assert jpeg_size(jpeg[:2] + comment * 300 + jpeg[2:]) == (8, 8)


SPOILT = {
    "a part longer than the file": HEADER + chunk(b"IDAT", b"short", 0x7FFF_001E) + REST,
    "an end that is cut off": PNG[:-4],
    "two headers": HEADER + HEADER[8:] + REST,
    "no end": PNG[:-12],
    "another part first": PNG_SIGNATURE + chunk(b"tIME", HEADER[16:24]) + HEADER[8:] + REST,
}


@pytest.mark.parametrize("data", SPOILT.values(), ids=SPOILT.keys())
def test_a_depth_picture_of_a_stranger_takes_no_more_room_than_it_has_pixels(data: bytes, bounded: None) -> None:
    message = SimpleNamespace(format="16UC1; compressedDepth", data=bytes(DEPTH_HEADER_BYTES) + data)
    with pytest.raises(BlockRobotError) as refusal:
        decode_depth(message)
    assert refusal.value.context["reason"] == "undecodable"
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_depth_png(data)


@pytest.mark.parametrize("kind", [b"iCCP", b"zTXt", b"acTL", b"fcTL", b"eXIf", b"tIME"])
def test_what_says_nothing_of_pixels_does_not_reach_the_decoder(kind: bytes, bounded: None) -> None:
    data = HEADER + chunk(kind, b"x\0\0" + zlib.compress(bytes(10_000_000), 9)) + REST
    assert keep_pixels(data) == PNG
    message = SimpleNamespace(format="16UC1; compressedDepth", data=bytes(DEPTH_HEADER_BYTES) + data)
    assert np.array_equal(decode_depth(message), DEPTH), "a camera may write what it likes beside"
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_depth_png(data)  # a robot writes pixels alone, and a custodian takes nothing else


def test_a_jpeg_that_draws_its_picture_again_and_again_is_refused(bounded: None) -> None:
    data = progressive(3_000)
    assert len(data) < 400_000
    with pytest.raises(BlockRobotError) as refusal:
        decode_colour_file(data)
    assert refusal.value.context["reason"] == "undecodable"
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        check_jpeg(data, SIDE_PX, SIDE_PX)


def test_a_progressive_jpeg_is_read_as_any(bounded: None) -> None:
    data = progressive(0)
    assert 5 < data.count(b"\xff\xda") <= JPEG_SCANS_MAX_COUNT // 4
    assert has_few_scans(data)
    assert decode_colour_file(data).shape == (SIDE_PX, SIDE_PX, 3)
    assert check_jpeg(data, SIDE_PX, SIDE_PX) == data


def test_nothing_but_a_signature_is_no_picture() -> None:
    assert keep_pixels(PNG_SIGNATURE) is None


SMALL = bytes(cv2.imencode(".jpg", np.zeros((16, 24, 3), np.uint8))[1])


@pytest.mark.parametrize("marker", [0x01, 0xC8, 0xD0, 0xDC, 0xF0])
def test_a_jpeg_in_which_two_decoders_would_find_two_pictures_is_refused(marker: int, bounded: None) -> None:
    frame = SMALL.index(b"\xff\xc0")
    large = SMALL[2 : frame + 5] + struct.pack(">HH", 30_000, 30_000) + SMALL[frame + 9 :]
    hidden = bytes((0xFF, marker)) + struct.pack(">H", len(large) + 2) + large
    data = SMALL[:2] + hidden + SMALL[frame : frame + 19] + b"\xff\xd9"
    assert jpeg_size(data) is None
    with pytest.raises(BlockRobotError) as refusal:
        decode_colour_file(data)
    assert refusal.value.context["reason"] == "undecodable"


@pytest.mark.parametrize("cut", range(0, 40, 3))
def test_of_a_jpeg_that_is_cut_off_no_size_is_told(cut: int) -> None:
    assert jpeg_size(SMALL) == (24, 16)
    assert jpeg_size(SMALL[:cut]) is None


def test_a_jpeg_with_two_sizes_is_refused() -> None:
    frame = SMALL.index(b"\xff\xc0")
    assert jpeg_size(SMALL[: frame + 19] + SMALL[frame:]) is None


def test_no_photograph_of_a_code_is_drawn_again_and_again(bounded: None) -> None:
    with pytest.raises(BlockRobotError, match="QR_UNREADABLE"):
        read_qr(progressive(3_000))
