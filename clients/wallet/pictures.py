"""Writes opened renditions as pictures that one can look at. Must never write more than the owner asked to see."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clients.sdk.picture import colourise, compose, decode_depth_png, encode_depth_png
from clients.wallet.viewing import RecordView, Viewing
from consensus.records.renditions import Rendition


def own_pixels(rendition: Rendition) -> bytes:
    """Return the owner's pixels alone on a whole frame, as 16-bit PNG in millimetres, 0 elsewhere."""
    whole = np.zeros((rendition.height, rendition.width), dtype=np.uint16)
    box = decode_depth_png(rendition.pixels)
    whole[rendition.y : rendition.y + rendition.box_height, rendition.x : rendition.x + rendition.box_width] = box
    return encode_depth_png(whole)


async def write_pictures(viewing: Viewing, view: RecordView, out: Path) -> list[Path]:
    """Write every whole frame of a record as `<sequence>.png` (colour map and legend) into `out`/<record id>/.

    Beside each stands `<sequence>.depth.png`, the owner's own pixels as measured. Returns the coloured pictures' paths.
    """
    folder = out / view.entry.record_id.hex()
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    backgrounds: dict[bytes, bytes] = {}
    for frame in view.frames:
        rendition = frame.rendition
        if rendition is None or rendition.box_width == 0:
            continue
        if rendition.background_id not in backgrounds:
            backgrounds[rendition.background_id] = await viewing.background(rendition, view.entry)
        depth = compose(
            backgrounds[rendition.background_id],
            rendition.x,
            rendition.y,
            rendition.box_width,
            rendition.box_height,
            rendition.pixels,
        )
        picture = folder / f"{rendition.sequence:08d}.png"
        picture.write_bytes(colourise(depth))
        (folder / f"{rendition.sequence:08d}.depth.png").write_bytes(own_pixels(rendition))
        written.append(picture)
    return written
