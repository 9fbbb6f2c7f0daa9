"""Strict PNG checks, which keep other data off custodians and wallets.

Format: https://www.w3.org/TR/png-3/
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from consensus.errors import BlockRobotError

SIDE_MAX_PX = 4_096
PARTS_SPARE_COUNT = 64
PART_USUAL_MIN_BYTES = 1_024
"""Encoders split pixels into parts of 8 KiB and more. Each part costs its reader time, however little is in it."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct(">IIBBBBB")
_FILTERS_COUNT = 5
_KNOWN_CHUNKS = frozenset({b"IHDR", b"IDAT", b"IEND"})


@dataclass(frozen=True, slots=True)
class PngKind:
    """A PNG kind: sample bits, colour type, pixel bytes and name."""

    bits: int
    colour: int
    pixel_bytes: int
    name: str


DEPTH = PngKind(16, 0, 2, "greyscale picture of 16 bits")
COLOUR = PngKind(8, 2, 3, "colour picture of 8 bits")
COLOUR_WITH_ALPHA = PngKind(8, 6, 4, "colour picture of 8 bits with transparency")


def _refuse(detail: str) -> BlockRobotError:
    return BlockRobotError("BACKGROUND_NOT_A_PICTURE", detail)


def most_parts(size_bytes: int) -> int:
    return PARTS_SPARE_COUNT + size_bytes // PART_USUAL_MIN_BYTES


def _read_chunks(content: bytes) -> list[tuple[bytes, bytes]]:
    at, most = len(_SIGNATURE), most_parts(len(content))
    chunks: list[tuple[bytes, bytes]] = []
    while at < len(content):
        if len(chunks) == most:
            raise _refuse("It is in more parts than a picture of its size.")
        length, kind = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
        end = at + 12 + length
        if kind not in _KNOWN_CHUNKS or end > len(content):
            raise _refuse("It has a part that such a picture does not have, or it is cut off.")
        if zlib.crc32(content[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            raise _refuse("A part of it is damaged.")
        chunks.append((kind, content[at + 8 : end - 4]))
        at = end
    return chunks


def check_depth_png(content: bytes) -> tuple[int, int]:
    """Return a depth picture's width and height. Raises BACKGROUND_NOT_A_PICTURE."""
    return check_png(content, DEPTH)


def check_png(content: bytes, kind: PngKind) -> tuple[int, int]:
    """Return a whole PNG's width and height. Raises BACKGROUND_NOT_A_PICTURE."""
    if not content.startswith(_SIGNATURE):
        raise _refuse("It is no PNG file.")
    chunks = _read_chunks(content)
    names = [name for name, _ in chunks]
    if len(names) < 3 or (names[0], names[-1]) != (b"IHDR", b"IEND") or set(names[1:-1]) != {b"IDAT"}:
        raise _refuse("Its parts are not those of a picture, in their order.")
    if len(chunks[0][1]) != _HEADER.size or chunks[-1][1]:
        raise _refuse("Its header or its end is of another size.")
    width, height, bits, colour, packing, filters, interlace = _HEADER.unpack(chunks[0][1])
    if (bits, colour, packing, filters, interlace) != (kind.bits, kind.colour, 0, 0, 0):
        raise _refuse(f"It is no {kind.name}.")
    if not (0 < width <= SIDE_MAX_PX and 0 < height <= SIDE_MAX_PX):
        raise _refuse(f"It is larger than {SIDE_MAX_PX} pixels.")
    row_bytes = 1 + kind.pixel_bytes * width
    unpacking = zlib.decompressobj()
    try:
        pixels = unpacking.decompress(b"".join(data for _, data in chunks[1:-1]), height * row_bytes + 1)
    except zlib.error:
        raise _refuse("Its pixels cannot be unpacked.") from None
    if len(pixels) != height * row_bytes or not unpacking.eof or unpacking.unused_data:
        raise _refuse("It has more or fewer pixels than it says.")
    if max(pixels[::row_bytes]) >= _FILTERS_COUNT:
        raise _refuse("A row of it has no filter that there is.")
    return width, height
