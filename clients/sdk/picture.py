"""Turns a rendition back into a picture that a person can look at: the owner's box on the recorded empty frame.

What comes in was stored elsewhere and is not trusted: a PNG is checked chunk by chunk before it is decoded. Must
never repair or guess: a picture that is not whole is refused.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from consensus.errors import BlockRobotError

Depth = npt.NDArray[np.uint16]

PICTURE_SIDE_MAX_PX = 4096
PNG_MAX_BYTES = 16 * 1024 * 1024
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
SHOWN_MIN_MM, SHOWN_MAX_MM = 400, 8_000
UNMEASURED_GREY = 48
LEGEND_HEIGHT_PX = 44
PNG_LEVEL = 3


def compose(empty_png: bytes, x: int, y: int, width: int, height: int, pixels_png: bytes) -> Depth:
    """Return the depth image (uint16 mm) of an empty frame with the owner's pixels in their box.

    Pixels of the box that are 0 are not the owner's and show the empty frame. Raises RENDITION_CORRUPTED when either
    PNG is damaged, is not 16-bit grey, or does not fit the box or the frame.
    """
    return compose_on(decode_depth_png(empty_png), x, y, width, height, pixels_png)


def compose_on(empty: Depth, x: int, y: int, width: int, height: int, pixels_png: bytes) -> Depth:
    """As `compose`, on an empty frame that was decoded before and is left as it is."""
    picture = empty.copy()
    pixels = decode_depth_png(pixels_png)
    if pixels.shape != (height, width):
        raise _corrupted("The owner's pixels do not have the size of their box.")
    if x < 0 or y < 0 or x + width > picture.shape[1] or y + height > picture.shape[0]:
        raise _corrupted("The owner's box does not lie inside the frame.")
    box = picture[y : y + height, x : x + width]
    np.copyto(box, pixels, where=pixels > 0)
    return picture


def decode_depth_png(png: bytes) -> Depth:
    """Return the uint16 image of a 16-bit grey PNG; raises RENDITION_CORRUPTED for anything else."""
    size = _check_png(png, _GREY)
    return np.array(_decode(png, size[::-1], np.uint16), dtype=np.uint16)


def decode_colour_png(png: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels of an 8-bit colour PNG without transparency; raises RENDITION_CORRUPTED for anything else."""
    width, height = _check_png(png, _RGB)
    return np.array(_decode(png, (height, width, 3), np.uint8), dtype=np.uint8)


def paint_colour(width: int, height: int, box: tuple[int, int, int, int], pixels_png: bytes) -> bytes:
    """Return a colour PNG of a whole frame, grey but for the owner's colour pixels in their `box` (x, y, width, height).

    Raises RENDITION_CORRUPTED when the PNG is damaged, has no transparency, or does not fit the box or the frame.
    """
    x, y, box_width, box_height = box
    if _check_png(pixels_png, _RGBA) != (box_width, box_height):
        raise _corrupted("The owner's pixels do not have the size of their box.")
    if x < 0 or y < 0 or x + box_width > width or y + box_height > height or max(width, height) > PICTURE_SIDE_MAX_PX:
        raise _corrupted("The owner's box does not lie inside the frame.")
    own = _decode(pixels_png, (box_height, box_width, 4), np.uint8)
    whole = np.full((height, width, 3), UNMEASURED_GREY, dtype=np.uint8)
    np.copyto(whole[y : y + box_height, x : x + box_width], own[..., :3], where=own[..., 3:] > 0)
    return _encode(whole)


def check_jpeg(data: bytes, width: int, height: int) -> bytes:
    """Return a JPEG if it is a whole colour picture of that size. Raises RENDITION_CORRUPTED."""
    if len(data) > PNG_MAX_BYTES or not data.startswith(b"\xff\xd8") or not data.endswith(b"\xff\xd9"):
        raise _corrupted("The picture is no JPEG, or not whole.")
    if max(width, height) > PICTURE_SIDE_MAX_PX:
        raise _corrupted("The picture is too large.")
    try:
        with Image.open(BytesIO(data), formats=("JPEG",)) as opened:
            if opened.size != (width, height):
                raise _corrupted("The picture does not have the size of its frame.")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _corrupted("The picture cannot be decoded.") from error
    _decode(data, (height, width, 3), np.uint8)
    return data


def _decode(data: bytes, shape: tuple[int, ...], kind: type[np.generic]) -> npt.NDArray[Any]:
    """Return the pixels of a picture whose size was checked before. Raises RENDITION_CORRUPTED."""
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise _corrupted("The picture cannot be decoded.") from error
    if image is None or image.shape != shape or image.dtype != kind:
        raise _corrupted("The picture cannot be decoded.")
    return np.asarray(image)


def encode_depth_png(depth: Depth) -> bytes:
    """Return a depth image (uint16, two-dimensional) as a 16-bit grey PNG, without loss."""
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise BlockRobotError("FRAME_INVALID", "A depth picture must be two-dimensional and of 16 bits.")
    return _encode(depth)


def colourise(depth: Depth, *, legend: bool = True) -> bytes:
    """Return a colour PNG of a depth image: near is blue, far is red, unmeasured dark grey, with a legend in metres."""
    colours = colour_pixels(depth)
    return encode_colour_png(np.vstack([colours, _legend(depth.shape[1])]) if legend else colours)


def colour_pixels(depth: Depth) -> npt.NDArray[np.uint8]:
    """Return the pixels of `colourise` without its legend (height x width x 3)."""
    span = SHOWN_MAX_MM - SHOWN_MIN_MM
    scaled = (np.clip(depth.astype(np.float32), SHOWN_MIN_MM, SHOWN_MAX_MM) - SHOWN_MIN_MM) * (255 / span)
    colours = np.asarray(cv2.applyColorMap(scaled.astype(np.uint8), cv2.COLORMAP_TURBO), dtype=np.uint8)
    colours[depth == 0] = UNMEASURED_GREY
    return colours


def encode_colour_png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return 8-bit colour pixels as a PNG."""
    return _encode(pixels)


def _legend(width: int) -> npt.NDArray[np.uint8]:
    """Return the strip below a picture: the colours with their distances, and the grey of what was not measured."""
    strip = np.full((LEGEND_HEIGHT_PX, width, 3), 255, dtype=np.uint8)
    left, right = 12, max(13, int(width * 0.68))
    ramp = np.linspace(0, 255, right - left).astype(np.uint8)[None, :].repeat(12, axis=0)
    strip[6:18, left:right] = np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO))
    for metres in range(1, SHOWN_MAX_MM // 1000 + 1):
        share = (metres * 1000 - SHOWN_MIN_MM) / (SHOWN_MAX_MM - SHOWN_MIN_MM)
        _write(strip, f"{metres} m", left + int(share * (right - left)) - 10)
    grey = right + 18
    strip[6:18, grey : grey + 12] = UNMEASURED_GREY
    _write(strip, "not measured", grey)
    return strip


def _write(strip: npt.NDArray[np.uint8], text: str, x: int) -> None:
    cv2.putText(strip, text, (x, 34), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (0, 0, 0), 1, cv2.LINE_AA)


def _encode(image: npt.NDArray[np.uint8] | Depth) -> bytes:
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not done:
        raise BlockRobotError("FRAME_INVALID", "The picture could not be written as PNG.")
    return data.tobytes()


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of PNG: its bits a sample, the header's colour type, the bytes of a pixel, and what to call it."""

    bits: int
    colour: int
    pixel_bytes: int
    name: str


_GREY = _Kind(16, 0, 2, "of 16-bit grey")
_RGBA = _Kind(8, 6, 4, "of 8-bit colour with transparency")
_RGB = _Kind(8, 2, 3, "of 8-bit colour")


def _check_png(png: bytes, kind: _Kind) -> tuple[int, int]:
    """Return (width, height) of a whole PNG of a kind: every chunk's checksum and the pixels' length are checked."""
    if len(png) > PNG_MAX_BYTES or not png.startswith(PNG_SIGNATURE):
        raise _corrupted("The picture is no PNG, or too large.")
    width = height = 0
    packed: list[bytes] = []
    place, ended = len(PNG_SIGNATURE), False
    while place < len(png):
        if ended or place + 12 > len(png):
            raise _corrupted("The picture ends in the wrong place.")
        (length,) = struct.unpack_from(">I", png, place)
        chunk, end = png[place + 4 : place + 8], place + 8 + length
        body = png[place + 8 : end]
        if end + 4 > len(png) or zlib.crc32(chunk + body) != struct.unpack_from(">I", png, end)[0]:
            raise _corrupted("A part of the picture is damaged or missing.")
        if chunk == b"IHDR":
            width, height = _check_header(body, kind, first=place == len(PNG_SIGNATURE))
        elif chunk == b"IDAT":
            packed.append(body)
        ended = chunk == b"IEND"
        place = end + 4
    if not ended or not width:
        raise _corrupted("The picture lacks its beginning or its end.")
    _check_length(b"".join(packed), height * (1 + kind.pixel_bytes * width))
    return width, height


def _check_header(body: bytes, kind: _Kind, *, first: bool) -> tuple[int, int]:
    if not first or len(body) != 13:
        raise _corrupted("The picture's header is damaged.")
    width, height, bits, colour, compression, filtering, interlace = struct.unpack(">IIBBBBB", body)
    if not (0 < width <= PICTURE_SIDE_MAX_PX and 0 < height <= PICTURE_SIDE_MAX_PX):
        raise _corrupted("The picture is empty or too large.")
    if (bits, colour, compression, filtering, interlace) != (kind.bits, kind.colour, 0, 0, 0):
        raise _corrupted(f"The picture is not {kind.name}.")
    return width, height


def _check_length(packed: bytes, expected: int) -> None:
    unpacker = zlib.decompressobj()
    try:
        length = len(unpacker.decompress(packed, expected + 1))
    except zlib.error as error:
        raise _corrupted("The picture's pixels are damaged.") from error
    if length != expected:
        raise _corrupted("The picture has too few or too many pixels.")


def _corrupted(detail: str) -> BlockRobotError:
    return BlockRobotError("RENDITION_CORRUPTED", detail)
