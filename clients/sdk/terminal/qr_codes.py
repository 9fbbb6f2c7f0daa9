"""QR codes: drawn for a terminal, a page or paper, and read from a picture. Must never guess: no code is no text."""

from __future__ import annotations

import itertools
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import segno
from PIL import Image
from rich.text import Text

from clients.sdk.pictures.picture_guard import JPEG_SIGNATURE, has_few_scans
from consensus.errors import BlockRobotError

PICTURE_MAX_BYTES = 16 * 1024 * 1024
PICTURE_SIDE_MAX_PX = 8_192
READ_SIDE_MAX_PX = 1_600
TEXT_FILE_MAX_BYTES = 4_096
_QUIET_MODULES = 4
_HALVES = {(False, False): " ", (True, False): "▀", (False, True): "▄", (True, True): "█"}
_PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "GIF")


def _matrix(text: str) -> list[list[bool]]:
    return [[bool(cell) for cell in row] for row in segno.make_qr(text, error="m").matrix_iter(border=_QUIET_MODULES)]


def qr_lines(text: str) -> Text:
    """Return a code for a terminal: two rows a line, black on white whatever the terminal's colours are."""
    rows = _matrix(text)
    if len(rows) % 2:
        rows.append([False] * len(rows[0]))
    pairs = zip(rows[::2], rows[1::2], strict=True)
    lines = ["".join(_HALVES[upper, lower] for upper, lower in zip(*pair, strict=True)) for pair in pairs]
    return Text("\n".join(lines), style="black on white", no_wrap=True)


def qr_columns(text: str) -> int:
    """Return how many columns a terminal needs for a code."""
    return len(_matrix(text))


def qr_svg(text: str) -> str:
    """Return a code as an SVG element for a page or a file, as large as its place."""
    rows = _matrix(text)
    cells = "".join(f"M{x} {y}h1v1h-1z" for y, row in enumerate(rows) for x, cell in enumerate(row) if cell)
    side = len(rows)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {side} {side}" shape-rendering="crispEdges" role="img" '
        f'aria-label="QR"><path fill="#fff" d="M0 0h{side}v{side}H0z"/><path fill="#000" d="{cells}"/></svg>\n'
    )


def read_qr(data: bytes) -> str:
    """Return the text of the QR code in a picture (PNG, JPEG, WebP, BMP, GIF). Raises QR_UNREADABLE."""
    if len(data) > PICTURE_MAX_BYTES:
        raise BlockRobotError("QR_UNREADABLE", f"The picture has more than {PICTURE_MAX_BYTES >> 20} MiB.")
    if data.startswith(JPEG_SIGNATURE) and not has_few_scans(data):
        raise BlockRobotError("QR_UNREADABLE", "The picture asks for more work than its pixels need.")
    try:
        with Image.open(BytesIO(data), formats=_PICTURES) as opened:
            if max(opened.size) > PICTURE_SIDE_MAX_PX:
                raise BlockRobotError("QR_UNREADABLE", f"The picture is wider than {PICTURE_SIDE_MAX_PX} pixels.")
            opened.thumbnail((READ_SIDE_MAX_PX, READ_SIDE_MAX_PX))
            grey = np.asarray(opened.convert("L"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise BlockRobotError("QR_UNREADABLE", "The file is no picture that can be read.") from None
    tries = (grey, cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), 255 - grey)
    for pixels, make in itertools.product(tries, (cv2.QRCodeDetector, cv2.QRCodeDetectorAruco)):
        try:  # the first detector is better at photographs, and misses one drawn code in a hundred
            text, _, _ = make().detectAndDecode(np.asarray(pixels, dtype=np.uint8))
        except cv2.error:
            continue
        if text:
            return str(text)
    raise BlockRobotError("QR_UNREADABLE")


def read_given(given: str) -> str:
    """Return what was given: itself, or for `@FILE` what the file says, a text or a picture of a QR code.

    So a secret need not stand on a command line, where everybody on the machine reads it. Raises FILE_UNUSABLE,
    QR_UNREADABLE.
    """
    if not given.startswith("@"):
        return given
    try:
        with Path(given[1:]).expanduser().open("rb") as file:
            data = file.read(PICTURE_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "no such name"
        raise BlockRobotError("FILE_UNUSABLE", f"{given[1:]}: {reason}.") from None
    try:
        text = data.decode("utf-8") if len(data) <= TEXT_FILE_MAX_BYTES else ""
    except UnicodeDecodeError:
        text = ""
    return text.strip() or read_qr(data)
