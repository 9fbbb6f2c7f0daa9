"""Sanitise untrusted pictures before decoding, against huge declared PNG parts and many JPEG scans."""

from __future__ import annotations

from consensus.records.png import most_parts

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8"
JPEG_SCANS_MAX_COUNT = 64
"""Encoders write at most some ten scans."""
JPEG_PARTS_MAX_COUNT = 1_024
"""Before the first scan. Encoders write some ten, and 255 more for a large colour profile."""

_PNG_PARTS = frozenset((b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"))
_SCAN = b"\xff\xda"
_START_OF_SCAN = 0xDA
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_TABLES = frozenset((0xC4, 0xCC, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)))


def keep_pixels(png: bytes) -> bytes | None:
    """Return a PNG's essential parts; None if malformed."""
    place, parts, headers_count = len(PNG_SIGNATURE), [PNG_SIGNATURE], 0
    for _ in range(most_parts(len(png))):
        if place + 12 > len(png):
            break
        kind, end = png[place + 4 : place + 8], place + 12 + int.from_bytes(png[place : place + 4], "big")
        if end > len(png):
            return None
        headers_count += kind == b"IHDR"
        if not headers_count:
            return None  # whoever looked at the size looked at the first part
        if kind in _PNG_PARTS:
            parts.append(png[place:end])
        if kind == b"IEND":
            return b"".join(parts) if headers_count == 1 else None
        place = end
    return None


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return a JPEG's size in pixels; None for unusual parts before the first scan (ITU-T T.81, B.2)."""
    place, found = 2, None
    for _ in range(JPEG_PARTS_MAX_COUNT):
        if not jpeg.startswith(JPEG_SIGNATURE) or place + 9 > len(jpeg) or jpeg[place] != 0xFF:
            break
        kind, length = jpeg[place + 1], int.from_bytes(jpeg[place + 2 : place + 4], "big")
        if kind == _START_OF_SCAN:
            return found
        if length < 2 or (kind in _JPEG_FRAMES and found) or kind not in _JPEG_FRAMES | _JPEG_TABLES:
            return None
        if kind in _JPEG_FRAMES:
            height, width = (int.from_bytes(jpeg[place + at : place + at + 2], "big") for at in (5, 7))
            found = width, height
        place += 2 + length
    return None


def has_few_scans(jpeg: bytes) -> bool:
    return jpeg.count(_SCAN) <= JPEG_SCANS_MAX_COUNT
