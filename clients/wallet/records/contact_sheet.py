"""Contact sheets (PNG) and animations (GIF) of many pictures, evenly sampled."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from anyascii import anyascii
from PIL import Image, ImageDraw, ImageFont

from clients.sdk.pictures.depth_colours import draw_legend

TILES_MAX_COUNT = 48
FRAMES_MAX_COUNT = 180
TILE_WIDTH_PX = 240
TILE_HEIGHT_MAX_PX = 480
"""A robot may say that a picture is 1 wide and 8192 high: as wide as a tile that would be gigabytes."""
SHEET_COLUMNS = 6
CAPTION_HEIGHT_PX = 18
HEADER_HEIGHT_PX = 34
GAP_PX = 6
FRAME_MIN_MS, FRAME_MAX_MS = 40, 1_000
_GROUND, _INK, _SOFT = (250, 250, 248), (28, 32, 36), (90, 96, 102)


@dataclass(frozen=True, slots=True)
class Tile:
    """One RGB picture of tile width; `is_depth` adds the distance scale."""

    label: str
    captured_at_ms: int
    picture: Image.Image
    is_depth: bool = False


class PictureSampler:
    """Keeps pictures at equal distances, in bounded memory."""

    def __init__(self, wanted: int = FRAMES_MAX_COUNT) -> None:
        self._wanted = wanted
        self._step = 1
        self._kept: list[Tile] = []
        self.count = 0
        """How many were taken in."""

    def take(self, label: str, captured_at_ms: int, make: Callable[[], Image.Image], *, is_depth: bool = False) -> None:
        """Add a picture; `make` is called only if the sheet keeps it."""
        wanted = self.count % self._step == 0
        self.count += 1
        if not wanted:
            return
        self._kept.append(Tile(label, captured_at_ms, fit(make()), is_depth))
        if len(self._kept) >= 2 * self._wanted:
            self._kept = self._kept[::2]
            self._step *= 2

    def some(self, most: int) -> list[Tile]:
        """At equal distances, including the first."""
        return evenly(self._kept, most)


def fit(picture: Image.Image) -> Image.Image:
    scale = min(TILE_WIDTH_PX / picture.width, TILE_HEIGHT_MAX_PX / picture.height)
    width, height = (max(1, round(side * scale)) for side in picture.size)
    fitted = picture.convert("RGB").resize((width, height))
    if width == TILE_WIDTH_PX:
        return fitted
    tile = Image.new("RGB", (TILE_WIDTH_PX, height), _GROUND)
    tile.paste(fitted, ((TILE_WIDTH_PX - width) // 2, 0))
    return tile


def evenly(tiles: Sequence[Tile], most: int) -> list[Tile]:
    """The first and the last are among them."""
    if len(tiles) <= most:
        return list(tiles)
    if most == 1:
        return [tiles[0]]
    return [tiles[round(number * (len(tiles) - 1) / (most - 1))] for number in range(most)]


def draw_sheet(tiles: Sequence[Tile], title: str, captions: Sequence[str]) -> bytes:
    columns = min(SHEET_COLUMNS, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    height = max(tile.picture.height for tile in tiles) + CAPTION_HEIGHT_PX
    width_px = max(columns * (TILE_WIDTH_PX + GAP_PX) + GAP_PX, 2 * (TILE_WIDTH_PX + GAP_PX) + GAP_PX)
    legend = _legend(tiles, 2 * TILE_WIDTH_PX)
    bottom = HEADER_HEIGHT_PX + rows * (height + GAP_PX) + GAP_PX
    sheet = Image.new("RGB", (width_px, bottom + (legend.height if legend else 0)), _GROUND)
    if legend:
        sheet.paste(legend, (GAP_PX, bottom))
    pen = ImageDraw.Draw(sheet)
    pen.text((GAP_PX + 2, 8), anyascii(title), fill=_INK, font=ImageFont.load_default(14))
    font = ImageFont.load_default(12)
    for number, (tile, caption) in enumerate(zip(tiles, captions, strict=True)):
        left = GAP_PX + number % columns * (TILE_WIDTH_PX + GAP_PX)
        top = HEADER_HEIGHT_PX + number // columns * (height + GAP_PX)
        sheet.paste(tile.picture, (left, top))
        pen.text((left + 2, top + height - CAPTION_HEIGHT_PX + 2), caption, fill=_SOFT, font=font)
    packed = BytesIO()
    sheet.save(packed, "PNG")
    return packed.getvalue()


def draw_animation(tiles: Sequence[Tile]) -> bytes:
    height, legend = max(tile.picture.height for tile in tiles), _legend(tiles, TILE_WIDTH_PX)
    frames = []
    for tile in tiles:
        frame = Image.new("RGB", (TILE_WIDTH_PX, height + (legend.height if legend else 0)), _GROUND)
        frame.paste(tile.picture, (0, 0))
        if legend:
            frame.paste(legend, (0, height))
            # Distance colours are few: a seventh of the usual method's time, and a quarter of its bytes.
            frame = frame.quantize(method=Image.Quantize.FASTOCTREE)
        frames.append(frame)
    gaps = [later.captured_at_ms - tile.captured_at_ms for tile, later in itertools.pairwise(tiles)]
    pauses = [min(FRAME_MAX_MS, max(FRAME_MIN_MS, gap)) for gap in gaps] + [FRAME_MAX_MS]
    packed = BytesIO()
    frames[0].save(packed, "GIF", save_all=True, append_images=frames[1:], duration=pauses, loop=0)
    return packed.getvalue()


def _legend(tiles: Sequence[Tile], width: int) -> Image.Image | None:
    if not any(tile.is_depth for tile in tiles):
        return None
    return Image.fromarray(np.ascontiguousarray(draw_legend(width)[..., ::-1]))


def draw_strip(tiles: Sequence[Tile]) -> Image.Image:
    height = max(tile.picture.height for tile in tiles)
    width, legend = len(tiles) * (TILE_WIDTH_PX + GAP_PX) - GAP_PX, _legend(tiles, TILE_WIDTH_PX)
    strip = Image.new("RGB", (width, height + (legend.height if legend else 0)), (0, 0, 0))
    for number, tile in enumerate(tiles):
        strip.paste(tile.picture, (number * (TILE_WIDTH_PX + GAP_PX), 0))
    if legend:
        strip.paste(legend, (0, height))
    return strip
