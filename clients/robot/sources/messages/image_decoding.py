"""Decodes raw or compressed ROS images to depth (mm) or colour.

Errors are FRAME_INVALID with reason encoding, size, step or undecodable. No measurement (0, NaN, infinite, negative,
maximum) is 0.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import DEPTH_HEIGHT_MAX_PX, DEPTH_WIDTH_MAX_PX, Depth, check_depth
from clients.sdk.pictures.picture_guard import PNG_SIGNATURE, has_few_scans, jpeg_size, keep_pixels
from consensus.errors import BlockRobotError

Colour = npt.NDArray[np.uint8]

COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
DEPTH_ENCODINGS = {"16UC1": 2, "mono16": 2, "32FC1": 4}
COLOUR_ENCODINGS = ("rgb8", "bgr8", "rgba8", "bgra8", "8UC3")
SATURATED_MM = 65_535
DEPTH_HEADER_BYTES = 12
"""What compressed_depth_image_transport writes before the PNG: the format and two parameters."""

_CHANNELS = {"rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_TO_RGB = {"bgr8": cv2.COLOR_BGR2RGB, "8UC3": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_RGBA2RGB}
_TO_RGB["bgra8"] = cv2.COLOR_BGRA2RGB


def refuse(reason: str, detail: str) -> BlockRobotError:
    return BlockRobotError("FRAME_INVALID", detail, reason=reason)


@contextlib.contextmanager
def refusing_other_fields() -> Iterator[None]:
    """Refuse messages whose fields differ from the ROS type they claim."""
    try:
        yield
    except BlockRobotError:
        raise
    except Exception as error:
        raise refuse("field", "The message has other fields than its type has in ROS.") from error


def encoding_of(message: Any) -> str:
    """Such as `16UC1` or `rgb8; jpeg`."""
    return str(getattr(message, "encoding", None) or getattr(message, "format", ""))


def could_be_depth(message: Any) -> bool:
    name = encoding_of(message)
    if hasattr(message, "encoding"):
        return name in DEPTH_ENCODINGS
    return "compresseddepth" in name.lower() and "rvl" not in name.lower()


def could_be_colour(message: Any) -> bool:
    name = encoding_of(message)
    if hasattr(message, "encoding"):
        return name in COLOUR_ENCODINGS
    return "compresseddepth" not in name.lower() and any(kind in name.lower() for kind in ("jpeg", "jpg", "png"))


def decode_depth(message: Any) -> Depth:
    """Uint16 mm, 0: no measurement. Raises FRAME_INVALID."""
    name = encoding_of(message)
    if not hasattr(message, "encoding"):
        return _compressed_depth(bytes(message.data), name)
    if name not in DEPTH_ENCODINGS:
        raise refuse("encoding", f"It is encoded as {name[:16]!r}, which is no depth that the robot reads.")
    rows = _rows(message, DEPTH_ENCODINGS[name])
    order = ">" if message.is_bigendian else "<"
    if name == "32FC1":
        return check_depth(_millimetres(rows.view(f"{order}f4")))
    return check_depth(_clean(rows.view(f"{order}u2").astype(np.uint16)))


def decode_colour(message: Any) -> Colour:
    """Uint8 RGB (height, width, 3). Raises FRAME_INVALID."""
    name = encoding_of(message)
    if not hasattr(message, "encoding"):
        return decode_colour_file(bytes(message.data))
    if name not in _CHANNELS:
        raise refuse("encoding", f"It is encoded as {name[:16]!r}, which is no colour that the robot reads.")
    channels = _CHANNELS[name]
    rows = _rows(message, channels)
    pixels = rows.reshape(rows.shape[0], -1, channels)
    if name in _TO_RGB:
        return np.asarray(cv2.cvtColor(pixels, _TO_RGB[name]), dtype=np.uint8)
    return pixels


def decode_colour_file(data: bytes) -> Colour:
    """Raises FRAME_INVALID."""
    image = _decode_file(data, cv2.IMREAD_COLOR)
    if image.ndim != 3 or image.dtype != np.uint8:
        raise refuse("encoding", "The compressed image is no colour image of 8 bits.")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _rows(message: Any, pixel_bytes: int) -> npt.NDArray[np.uint8]:
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not (0 < height <= DEPTH_HEIGHT_MAX_PX and 0 < width <= DEPTH_WIDTH_MAX_PX):
        raise refuse("size", f"{width}x{height} pixels is empty or too large.")
    data = np.frombuffer(message.data, dtype=np.uint8)
    if step < width * pixel_bytes:
        raise refuse("step", f"A row of {width} pixels does not fit into a step of {step} bytes.")
    if len(data) != step * height:
        raise refuse("size", f"{width}x{height} pixels with a step of {step} are not {len(data)} bytes.")
    return np.ascontiguousarray(data.reshape(height, step)[:, : width * pixel_bytes])


def _clean(depth: Depth) -> Depth:
    """Drop an encoding's maximum value, which means no measurement."""
    saturated = depth == SATURATED_MM
    return np.where(saturated, np.uint16(0), depth) if saturated.any() else depth


def _millimetres(metres: npt.NDArray[Any]) -> Depth:
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = metres.astype(np.float32) * np.float32(1000)
        good = np.isfinite(scaled) & (scaled >= 0.5) & (scaled < SATURATED_MM - 0.5)
        return np.where(good, np.rint(np.where(good, scaled, 0)), 0).astype(np.uint16)


def _compressed_depth(data: bytes, name: str) -> Depth:
    """Decode `compressedDepth`: 12 parameter bytes, then 16-bit PNG."""
    if "compresseddepth" not in name.lower() or "rvl" in name.lower():
        raise refuse("encoding", f"{name[:40]!r} is no compressed depth that the robot reads.")
    if len(data) <= DEPTH_HEADER_BYTES:
        raise refuse("size", "The compressed image is empty.")
    raw = _decode_file(data[DEPTH_HEADER_BYTES:], cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype != np.uint16:
        raise refuse("encoding", "The compressed depth is no grey image of 16 bits.")
    if not name.startswith("32FC1"):
        return check_depth(_clean(np.asarray(raw, dtype=np.uint16)))
    _, factor, offset = struct.unpack_from("<iff", data)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        metres = np.float32(factor) / (raw.astype(np.float32) - np.float32(offset))
    return check_depth(_millimetres(np.where(raw == 0, np.float32(np.nan), metres)))


def _decode_file(data: bytes, mode: int) -> npt.NDArray[Any]:
    """Size is checked before decoding."""
    width, height = _file_size(data)
    if not (0 < height <= DEPTH_HEIGHT_MAX_PX and 0 < width <= DEPTH_WIDTH_MAX_PX):
        raise refuse("size", f"{width}x{height} pixels is empty or too large.")
    is_png = data.startswith(PNG_SIGNATURE)
    bounded = keep_pixels(data) if is_png else data
    if bounded is None or not (is_png or has_few_scans(data)):
        raise refuse("undecodable", "The compressed image is damaged, or asks for more work than its pixels need.")
    try:
        image = cv2.imdecode(np.frombuffer(bounded, dtype=np.uint8), mode)
    except cv2.error as error:
        raise refuse("undecodable", "The compressed image cannot be decoded.") from error
    if image is None or image.shape[:2] != (height, width):
        raise refuse("undecodable", "The compressed image cannot be decoded.")
    return np.asarray(image)


def _file_size(data: bytes) -> tuple[int, int]:
    if data.startswith(PNG_SIGNATURE) and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    size = jpeg_size(data)
    if size is None:
        raise refuse("undecodable", "The compressed image is neither PNG nor JPEG, or damaged.")
    return size
