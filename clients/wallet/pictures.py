"""Writes opened renditions as pictures that one can look at. Must never write more than the owner asked to see."""

from __future__ import annotations

from pathlib import Path

from clients.sdk.picture import colourise, compose
from clients.wallet.viewing import RecordView, Viewing


async def write_pictures(viewing: Viewing, view: RecordView, out: Path) -> list[Path]:
    """Write every whole frame of a record as `<sequence>.png` (colour map and legend) into `out`/<record id>/.

    Beside it stands `<sequence>.depth.png`: the owner's own pixels, 16-bit millimetres, whole frame, 0 elsewhere.
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
        picture = folder / f"{rendition.sequence:08d}.png"
        picture.write_bytes(colourise(compose(backgrounds[rendition.background_id], rendition)))
        own = folder / f"{rendition.sequence:08d}.depth.png"
        own.write_bytes(rendition.pixels)
        written.append(picture)
    return written
