"""Writes opened renditions as files that one can look at or hear. Must never write more than the owner asked to see."""

from __future__ import annotations

import os
import re
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from clients.sdk.picture import Depth, colour_pixels, colourise, compose
from clients.sdk.rendition_files import own_pixels, sense_file
from clients.wallet.viewing import FrameView, RecordView, Viewing
from consensus.records.renditions import ENCODING_JPEG, ENCODING_PNG16, ENCODING_PNG_RGBA, Rendition

_PRIVATE_FILE, _PRIVATE_FOLDER = 0o600, 0o700
_WRITTEN = re.compile(r"[0-9]{8,}\.(png|depth\.png|rgb\.png|rgb\.jpg|label\.json|wav)")
FindBackground = Callable[[Rendition], Awaitable[bytes]]
Seen = Callable[[int, Callable[[], Image.Image]], None]


async def write_pictures(viewing: Viewing, view: RecordView, out: Path, seen: Seen | None = None) -> list[Path]:
    """Write every whole frame of a record as `<sequence>.png` (colour map and legend) into `out`/<record id>/.

    Beside each stands `<sequence>.depth.png`, the owner's own pixels as measured. Other senses become
    `<sequence>.rgb.png` or `.rgb.jpg`, `.label.json` and `.wav`. Returns the paths of what is there to look at or hear.
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
    """Write the whole frames of any record, as `write_pictures` does; `background` fetches a recorded empty frame.

    `seen` is told of each picture: when it was taken (ms), and how to make it.

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
            write_private(other, data)
            written.append(other)
            if seen is not None and rendition.encoding in {ENCODING_JPEG, ENCODING_PNG_RGBA}:
                seen(rendition.captured_at_ms, partial(_open, data))
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
        write_private(picture, colourise(depth))
        write_private(folder / f"{rendition.sequence:08d}.depth.png", own_pixels(rendition))
        written.append(picture)
        if seen is not None:
            seen(rendition.captured_at_ms, partial(_paint, depth))
    return written


def _open(data: bytes) -> Image.Image:
    return Image.open(BytesIO(data)).convert("RGB")


def _paint(depth: Depth) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(colour_pixels(depth)[..., ::-1]))


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


def write_private(path: Path, data: bytes) -> None:
    """Write a file that only the user of this machine reads."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, _PRIVATE_FILE)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, _PRIVATE_FILE)  # one of an earlier look may be open to others
        file.write(data)
