"""Folder of empty frames awaiting approval, and their combined preview."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clients.sdk.pictures.rendition_picture import colourise, decode_depth_png
from consensus.errors import BlockRobotError
from consensus.records.png import check_depth_png

ROBOT_FILE = "robot.txt"
PREVIEW_FILE = "preview.png"
PREVIEW_COLUMNS = 8
PREVIEW_MAX_PIXELS = 64 * 1024 * 1024


def draw_preview(pngs: Sequence[bytes]) -> bytes:
    """Return one colour PNG, unscaled, eight per row. Raises BACKGROUND_NOT_A_PICTURE, BACKGROUND_INVALID."""
    sizes = [check_depth_png(png) for png in pngs]
    width, height = max(size[0] for size in sizes), max(size[1] for size in sizes)
    columns = min(PREVIEW_COLUMNS, len(pngs))
    rows = -(-len(pngs) // columns)
    if rows * height * columns * width > PREVIEW_MAX_PIXELS:
        detail = f"Together they have more than {PREVIEW_MAX_PIXELS >> 20} megapixels: approve them in parts."
        raise BlockRobotError("BACKGROUND_INVALID", detail)
    sheet = np.zeros((rows * height, columns * width), dtype=np.uint16)
    for number, (png, size) in enumerate(zip(pngs, sizes, strict=True)):
        top, left = number // columns * height, number % columns * width
        sheet[top : top + size[1], left : left + size[0]] = decode_depth_png(png)
    return colourise(sheet)
