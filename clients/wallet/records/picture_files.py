"""Writes opened renditions as picture, label and sound files."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from clients.sdk.new_files import require_own_folder, write_private
from clients.sdk.pictures.depth_colours import Depth, colour_pixels
from clients.sdk.pictures.picture_names import is_picture_name, name_picture
from clients.sdk.pictures.rendition_files import own_depth, own_pixels, sense_file
from clients.sdk.pictures.rendition_picture import colourise, compose_on, decode_depth_png
from clients.wallet.records.viewing import FrameView, RecordView, RecordViewer
from consensus.records.renditions import ENCODING_JPEG, ENCODING_PNG16, ENCODING_PNG_RGBA, Rendition

FindBackground = Callable[[Rendition], Awaitable[bytes | None]]
Seen = Callable[[int, int, Callable[[], Image.Image], bool], None]


async def write_pictures(viewing: RecordViewer, view: RecordView, out: Path, seen: Seen | None = None) -> list[Path]:
    """Write whole frames as `picture-0005.frame-00000009.png` (place from 1, robot's frame count) into `out`/<record
    id>/; return all paths.

    `.depth.png` holds the measured pixels.
    """
    return await write_frames(
        lambda rendition: viewing.background(rendition, view.entry), view.entry.record_id, view.frames, out, seen
    )


async def write_frames(
    background: FindBackground,
    record_id: bytes,
    frames: Sequence[FrameView],
    out: Path,
    seen: Seen | None = None,
) -> list[Path]:
    """Write whole frames, readable by this user only.

    `seen` gets number from 1, capture time (ms), maker, whether colours are distances. Raises FILE_EXISTS for a link.
    """
    folder = out / record_id.hex()
    require_own_folder(folder)
    written = []
    backgrounds: dict[bytes, Depth | None] = {}
    for frame in frames:
        rendition = frame.rendition
        if rendition is None or not rendition.pixels:
            continue
        if rendition.encoding != ENCODING_PNG16:
            suffix, data = sense_file(rendition)
            other = folder / name_picture(frame.index, rendition.sequence, suffix)
            write_private(other, data)
            written.append(other)
            if seen is not None and rendition.encoding in {ENCODING_JPEG, ENCODING_PNG_RGBA}:
                seen(frame.index + 1, rendition.captured_at_ms, partial(_open, data), False)
            continue
        if rendition.background_id not in backgrounds:
            empty_png = await background(rendition)
            backgrounds[rendition.background_id] = None if empty_png is None else decode_depth_png(empty_png)
        depth = _compose(backgrounds[rendition.background_id], rendition)
        for suffix, data in (("png", colourise(depth)), ("depth.png", own_pixels(rendition))):
            written.append(folder / name_picture(frame.index, rendition.sequence, suffix))
            write_private(written[-1], data)
        if seen is not None:
            seen(frame.index + 1, rendition.captured_at_ms, partial(_paint, depth), True)
    return written


def _compose(empty: Depth | None, rendition: Rendition) -> Depth:
    if empty is None:
        return own_depth(rendition)
    box = (rendition.x, rendition.y, rendition.box_width, rendition.box_height)
    return compose_on(empty, *box, rendition.pixels)


def _open(data: bytes) -> Image.Image:
    return Image.open(BytesIO(data)).convert("RGB")


def _paint(depth: Depth) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(colour_pixels(depth)[..., ::-1]))


def delete_frames(folder: Path) -> list[Path]:
    """Delete what `write_frames` wrote; return other files, which stay. Raises FILE_EXISTS for a link."""
    require_own_folder(folder)
    others = []
    for path in sorted(folder.iterdir()):
        if is_picture_name(path.name) and not path.is_dir():
            path.unlink()
        else:
            others.append(path)
    if not others:
        folder.rmdir()
    return others
