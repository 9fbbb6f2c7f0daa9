"""Writes opened renditions as files that one can look at or hear. Must never write more than the owner asked to see."""

from __future__ import annotations

import json
import struct
import wave
from io import BytesIO
from pathlib import Path

import numpy as np

from clients.sdk.picture import (
    check_jpeg,
    colourise,
    compose,
    decode_depth_png,
    encode_depth_png,
    paint_colour,
)
from clients.wallet.viewing import RecordView, Viewing
from consensus.errors import BlockRobotError
from consensus.records.renditions import (
    ENCODING_JPEG,
    ENCODING_PNG16,
    ENCODING_PNG_RGBA,
    ENCODING_WAV,
    Rendition,
)

LABEL_MAX_BYTES = 4_096


def sense_file(rendition: Rendition) -> tuple[str, bytes]:
    """Return the file (its suffix and bytes) of a rendition of another sense. Raises RENDITION_CORRUPTED."""
    if rendition.encoding == ENCODING_PNG_RGBA:
        box = (rendition.x, rendition.y, rendition.box_width, rendition.box_height)
        return "rgb.png", paint_colour(rendition.width, rendition.height, box, rendition.pixels)
    if rendition.encoding == ENCODING_JPEG:
        return "rgb.jpg", check_jpeg(rendition.pixels, rendition.width, rendition.height)
    if rendition.encoding == ENCODING_WAV:
        return "wav", _check_wav(rendition.pixels)
    return "label.json", _check_label(rendition.pixels)


def _check_wav(data: bytes) -> bytes:
    try:
        with wave.open(BytesIO(data)) as file:
            whole = file.getnframes() * file.getnchannels() * file.getsampwidth()
            if len(file.readframes(file.getnframes())) != whole:
                raise EOFError
    except (wave.Error, EOFError, struct.error) as error:
        raise BlockRobotError("RENDITION_CORRUPTED", "The sound is damaged.") from error
    return data


def _check_label(data: bytes) -> bytes:
    """Return a label as JSON written anew, so that nothing else can hide in it."""
    try:
        told = json.loads(data[:LABEL_MAX_BYTES].decode("utf-8"))
    except ValueError as error:
        raise BlockRobotError("RENDITION_CORRUPTED", "The label is damaged.") from error
    if not isinstance(told, dict) or not isinstance(told.get("label"), str) or len(data) > LABEL_MAX_BYTES:
        raise BlockRobotError("RENDITION_CORRUPTED", "The label is damaged.")
    return json.dumps(told, ensure_ascii=False, indent=2, sort_keys=True).encode() + b"\n"


def own_pixels(rendition: Rendition) -> bytes:
    """Return the owner's pixels alone on a whole frame, as 16-bit PNG in millimetres, 0 elsewhere."""
    whole = np.zeros((rendition.height, rendition.width), dtype=np.uint16)
    box = decode_depth_png(rendition.pixels)
    whole[rendition.y : rendition.y + rendition.box_height, rendition.x : rendition.x + rendition.box_width] = box
    return encode_depth_png(whole)


async def write_pictures(viewing: Viewing, view: RecordView, out: Path) -> list[Path]:
    """Write every whole frame of a record as `<sequence>.png` (colour map and legend) into `out`/<record id>/.

    Beside each stands `<sequence>.depth.png`, the owner's own pixels as measured. Other senses become
    `<sequence>.rgb.png` or `.rgb.jpg`, `.label.json` and `.wav`. Returns the paths of what is there to look at or hear.
    """
    folder = out / view.entry.record_id.hex()
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    backgrounds: dict[bytes, bytes] = {}
    for frame in view.frames:
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
