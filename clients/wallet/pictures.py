"""Writes opened renditions as files that one can look at or hear. Must never write more than the owner asked to see."""

from __future__ import annotations

import os
import re
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from clients.sdk.picture import colourise, compose
from clients.sdk.rendition_files import own_pixels, sense_file
from clients.wallet.viewing import FrameView, RecordView, Viewing
from consensus.records.renditions import ENCODING_PNG16, Rendition

_PRIVATE_FILE, _PRIVATE_FOLDER = 0o600, 0o700
_WRITTEN = re.compile(r"[0-9]{8,}\.(png|depth\.png|rgb\.png|rgb\.jpg|label\.json|wav)")
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
    """Write the whole frames of any record, as `write_pictures` does; `background` fetches a recorded empty frame.

    Only the user of this machine reads them: they are pictures of a person.
    """
    folder = out / record_id.hex()
    folder.mkdir(parents=True, exist_ok=True, mode=_PRIVATE_FOLDER)
    written = []
    backgrounds: dict[bytes, bytes] = {}
    for frame in frames:
        rendition = frame.rendition
        if rendition is None or not rendition.pixels:
            continue
        if rendition.encoding != ENCODING_PNG16:
            suffix, data = sense_file(rendition)
            other = folder / f"{rendition.sequence:08d}.{suffix}"
            _write(other, data)
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
        _write(picture, colourise(depth))
        _write(folder / f"{rendition.sequence:08d}.depth.png", own_pixels(rendition))
        written.append(picture)
    return written


def delete_frames(folder: Path) -> list[Path]:
    """Delete what `write_frames` wrote into a record's folder, and the folder unless it holds anything else.

    Returns what else it holds: files of the user's own are not ours to delete.
    """
    others = []
    for path in sorted(folder.iterdir()):
        if _WRITTEN.fullmatch(path.name) and not path.is_dir():
            path.unlink()
        else:
            others.append(path)
    if not others:
        folder.rmdir()
    return others


def _write(path: Path, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, _PRIVATE_FILE)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, _PRIVATE_FILE)  # one of an earlier look may be open to others
        file.write(data)
