"""Writes opened renditions as files that one can look at or hear. Must never write more than the owner asked to see."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from clients.sdk.picture import colourise, compose
from clients.sdk.rendition_files import own_pixels, sense_file
from clients.wallet.viewing import FrameView, RecordView, Viewing
from consensus.records.renditions import ENCODING_PNG16, Rendition

FindBackground = Callable[[Rendition], Awaitable[bytes]]


async def write_pictures(viewing: Viewing, view: RecordView, out: Path) -> list[Path]:
    """Write every whole frame of a record as `<sequence>.png` (colour map and legend) into `out`/<record id>/.

    Beside each stands `<sequence>.depth.png`, the owner's own pixels as measured. Other senses become
    `<sequence>.rgb.png` or `.rgb.jpg`, `.label.json` and `.wav`. Returns the paths of what is there to look at or hear.
    """
    return await write_frames(
        lambda rendition: viewing.background(rendition, view.entry), view.entry.record_id, view.frames, out
    )


async def write_frames(
    background: FindBackground, record_id: bytes, frames: Sequence[FrameView], out: Path
) -> list[Path]:
    """Write the whole frames of any record, as `write_pictures` does; `background` fetches a recorded empty frame."""
    folder = out / record_id.hex()
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    backgrounds: dict[bytes, bytes] = {}
    for frame in frames:
        rendition = frame.rendition
        if rendition is None or not rendition.pixels:
            continue
        if rendition.encoding != ENCODING_PNG16:
            suffix, data = sense_file(rendition)
            other = folder / f"{rendition.sequence:08d}.{suffix}"
            other.write_bytes(data)
            written.append(other)
            continue
        if rendition.background_id not in backgrounds:
            backgrounds[rendition.background_id] = await background(rendition)
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
