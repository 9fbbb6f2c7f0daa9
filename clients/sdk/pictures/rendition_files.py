"""Renditions as files that people and other programs can open."""

from __future__ import annotations

import json
import struct
import wave
from io import BytesIO

import numpy as np

from clients.sdk.pictures.depth_colours import Depth
from clients.sdk.pictures.rendition_picture import check_jpeg, decode_depth_png, encode_depth_png, paint_colour
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.records.renditions import ENCODING_JPEG, ENCODING_PNG_RGBA, ENCODING_WAV, Rendition

LABEL_MAX_BYTES = 4_096


def sense_file(rendition: Rendition) -> tuple[str, bytes]:
    """Suffix and bytes; not of depth. Raises RENDITION_CORRUPTED."""
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
    try:
        content = read_json_text(data[:LABEL_MAX_BYTES].decode("utf-8"))
        if not isinstance(content, dict) or not isinstance(content.get("label"), str) or len(data) > LABEL_MAX_BYTES:
            raise ValueError
        return json.dumps(content, ensure_ascii=False, indent=2, sort_keys=True).encode() + b"\n"
    except ValueError as error:
        raise BlockRobotError("RENDITION_CORRUPTED", "The label is damaged.") from error


def own_pixels(rendition: Rendition) -> bytes:
    """On a whole frame: 16-bit PNG, mm, 0 elsewhere. Raises RENDITION_CORRUPTED."""
    return encode_depth_png(own_depth(rendition))


def own_depth(rendition: Rendition) -> Depth:
    """The same as an array of millimetres."""
    whole = np.zeros((rendition.height, rendition.width), dtype=np.uint16)
    box = decode_depth_png(rendition.pixels)
    if box.shape != (rendition.box_height, rendition.box_width):
        raise BlockRobotError("RENDITION_CORRUPTED", "The owner's pixels do not have the size of their box.")
    whole[rendition.y : rendition.y + rendition.box_height, rendition.x : rendition.x + rendition.box_width] = box
    return whole
