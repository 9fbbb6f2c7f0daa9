"""Every way in which a camera driver may hand over an image, and every way in which it may be wrong."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from clients.robot.sources.messages.image_decoding import decode_colour, decode_depth
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import image

DEPTH = np.array([[0, 1, 850], [4000, 12_000, 65_534]], np.uint16)
RED = np.zeros((3, 4, 3), np.uint8)
RED[..., 0] = 200


def message(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**fields)


def compressed(kind: str, data: bytes) -> SimpleNamespace:
    return message(format=kind, data=np.frombuffer(data, np.uint8))


def png(pixels: Any, suffix: str = ".png") -> bytes:
    done, data = cv2.imencode(suffix, pixels)
    assert done
    return bytes(data.tobytes())


def reason_of(refused: pytest.ExceptionInfo[BlockRobotError]) -> str:
    assert refused.value.code == "FRAME_INVALID"
    return str(refused.value.context["reason"])


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("pad", [0, 1, 2, 7])
def test_millimetres_come_out_the_same_in_either_byte_order_and_with_any_step(
    encoding: str, big: bool, pad: int
) -> None:
    depth = decode_depth(message(**image(DEPTH, encoding, big=big, pad=pad)))
    assert depth.dtype == np.uint16
    assert np.array_equal(depth, DEPTH)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("pad", [0, 3])
def test_metres_become_millimetres_and_what_is_no_distance_becomes_none(big: bool, pad: int) -> None:
    metres = np.array([[np.nan, np.inf, -np.inf, -1.0], [0.0, 0.8504, 65.6, 3.0]], np.float32)
    depth = decode_depth(message(**image(metres, "32FC1", big=big, pad=pad)))
    assert depth.tolist() == [[0, 0, 0, 0], [0, 850, 0, 3000]]


def test_saturated_or_missing_depth_is_no_measurement_and_depth_no_colour() -> None:
    depth = decode_depth(message(**image(np.full((2, 2), 65_535, np.uint16))))
    assert not depth.any()
    assert decode_depth(message(**image(np.zeros((4, 4), np.uint16)))).shape == (4, 4)
    with pytest.raises(BlockRobotError) as refused:
        decode_colour(message(**image(DEPTH)))
    assert reason_of(refused) == "encoding"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "rgb8"}, "encoding"),
        ({"encoding": ""}, "encoding"),
        ({"encoding": "32FC1"}, "step"),
        ({"step": 5}, "step"),
        ({"step": 0}, "step"),
        ({"step": 8}, "size"),
        ({"height": 3}, "size"),
        ({"width": 4}, "step"),
        ({"width": 0}, "size"),
        ({"height": 0}, "size"),
        ({"width": 2**31}, "size"),
        ({"data": np.ones(3, np.uint8)}, "size"),
        ({"data": np.zeros(0, np.uint8)}, "size"),
    ],
)
def test_a_frame_that_contradicts_itself_is_refused_with_a_reason(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        decode_depth(message(**{**image(DEPTH), **changes}))
    assert reason_of(refused) == reason


@pytest.mark.parametrize("kind", ["16UC1; compressedDepth", "16UC1; compressedDepth png"])
def test_compressed_depth_is_read(kind: str) -> None:
    assert np.array_equal(decode_depth(compressed(kind, bytes(12) + png(DEPTH))), DEPTH)


def test_compressed_metres_are_read_by_the_two_parameters_before_the_picture() -> None:
    factor, offset = 10_000.0, -100.0
    metres = np.array([[1.0, 2.0], [4.0, 8.0]])
    packed = np.rint(factor / metres + offset).astype(np.uint16)
    packed[0, 0] = 0
    depth = decode_depth(compressed("32FC1; compressedDepth png", struct.pack("<iff", 0, factor, offset) + png(packed)))
    assert depth[0, 0] == 0
    assert np.abs(depth[1].astype(int) - [4000, 8000]).max() <= 20


@pytest.mark.parametrize(
    ("kind", "data", "reason"),
    [
        ("16UC1; compressedDepth rvl", bytes(40), "encoding"),
        ("jpeg", bytes(12) + png(DEPTH), "encoding"),
        ("16UC1; compressedDepth", b"", "size"),
        ("16UC1; compressedDepth", bytes(12) + b"GIF89a" + bytes(40), "undecodable"),
        ("16UC1; compressedDepth", bytes(12) + png(DEPTH)[:40], "undecodable"),
        ("16UC1; compressedDepth", bytes(12) + png(np.zeros((3, 3, 3), np.uint8)), "encoding"),
        ("16UC1; compressedDepth", bytes(12) + png(DEPTH)[:16] + struct.pack(">II", 1 << 30, 1 << 30), "size"),
    ],
)
def test_bad_compressed_depth_is_refused_with_a_reason(kind: str, data: bytes, reason: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        decode_depth(compressed(kind, data))
    assert reason_of(refused) == reason


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "8UC3", "rgba8", "bgra8"])
def test_colour_comes_out_red_first(encoding: str) -> None:
    pixels = RED if encoding.startswith("rgb") else RED[..., ::-1]
    if encoding.endswith("a8"):
        pixels = np.dstack([pixels, np.full((3, 4), 255, np.uint8)])
    assert np.array_equal(decode_colour(message(**image(np.ascontiguousarray(pixels), encoding, pad=2))), RED)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_colour_is_read(suffix: str) -> None:
    colour = decode_colour(compressed("rgb8; jpeg compressed bgr8", png(RED[..., ::-1], suffix)))
    assert np.abs(colour.astype(int) - RED).max() <= 4
