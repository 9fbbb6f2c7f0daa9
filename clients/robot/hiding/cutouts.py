"""Cuts one silhouette as PNG16, never another's pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.background import PNG_LEVEL, Background
from clients.robot.hiding.segmentation import DEPTH_EDGE_MM, Segmented, Silhouette, foreground_of
from clients.robot.hiding.silhouette_parts import find_behind_mm
from clients.robot.sensing.sensor_events import Depth
from consensus.errors import BlockRobotError

REGROW_PX = 3
BODY_DEPTH_MM = 650
STEP_MM = np.uint16(DEPTH_EDGE_MM)  # a pixel at the edge is the owner's only if theirs beside it are as near
FAINT_SHARE = 0.5

_Pixel = TypeVar("_Pixel", np.uint8, np.uint16)

_REGROW = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * REGROW_PX + 1, 2 * REGROW_PX + 1))
_FARTHEST_MM = np.uint16(65_535)
_FENCE = np.ones((5, 5), np.uint8)
# Without filters: depth is noisy in its low bytes. Measured a fifth to a quarter smaller, in less than half the time.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
_BESIDE = np.ones((5, 5), np.uint8)  # at half resolution: as far as an edge is regrown


@dataclass(frozen=True, slots=True)
class EncodedCutout:
    """The owner's box (pixels) and PNG16, 0 elsewhere."""

    x: int
    y: int
    width: int
    height: int
    pixels_png: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """Unencoded pixels: box corner and box, 0 elsewhere."""

    x: int
    y: int
    pixels: Depth


def extract_encoded_cutout(
    depth: Depth, background: Background, segmented: Segmented, silhouette: Silhouette
) -> EncodedCutout:
    return encode_cutout(extract_cutout(depth, background, segmented, silhouette))


def encode_cutout(out: Cutout) -> EncodedCutout:
    """Raises FRAME_INVALID."""
    done, data = cv2.imencode(".png", out.pixels, _PNG)
    if not done:
        raise BlockRobotError("FRAME_INVALID", "A rendition could not be written as PNG.")
    return EncodedCutout(out.x, out.y, out.pixels.shape[1], out.pixels.shape[0], data.tobytes())


def extract_cutout(depth: Depth, background: Background, segmented: Segmented, silhouette: Silhouette) -> Cutout:
    """Edges are regrown by 3 px into foreground. Nothing behind the largest part is shown: it may be somebody else's."""
    assert segmented.labels is not None
    left, top, width, height = silhouette.box
    x0, y0 = max(0, 2 * left - 4), max(0, 2 * top - 4)
    x1 = min(depth.shape[1], 2 * (left + width) + 4)
    y1 = min(depth.shape[0], 2 * (top + height) + 4)
    box = (slice(y0, y1), slice(x0, x1))
    pixels = depth[box]
    labels = segmented.labels[y0 // 2 : (y1 + 1) // 2, x0 // 2 : (x1 + 1) // 2]
    size = (2 * labels.shape[1], 2 * labels.shape[0])
    inside = labels == silhouette.label
    own = _enlarge(inside.view(np.uint8), size, pixels.shape, 255)
    mask = np.asarray(cv2.dilate(own, _REGROW))
    faint = (background.threshold[box] * np.float32(FAINT_SHARE)).astype(np.uint16)
    mask = np.asarray(cv2.bitwise_and(mask, foreground_of(pixels, background.depth[box], faint)))
    half = pixels[::2, ::2]
    low = silhouette.median_mm - BODY_DEPTH_MM
    high = min(silhouette.median_mm + BODY_DEPTH_MM, find_behind_mm(inside, half))
    mask = np.asarray(cv2.bitwise_and(mask, cv2.inRange(pixels, max(low, 1), high)))
    nearest = np.asarray(cv2.erode(np.where(inside, half, _FARTHEST_MM), _BESIDE), dtype=np.uint16)
    farthest = np.asarray(cv2.dilate(np.where(inside, half, np.uint16(0)), _BESIDE), dtype=np.uint16)
    low_mm = _enlarge(np.maximum(nearest, STEP_MM) - STEP_MM, size, pixels.shape)
    high_mm = _enlarge(np.minimum(farthest, _FARTHEST_MM - STEP_MM) + STEP_MM, size, pixels.shape)
    mask[(pixels < low_mm) | (pixels > high_mm)] = 0
    others = (labels != 0) & (labels != silhouette.label)
    if others.any():
        fence = cv2.dilate(_enlarge(others.view(np.uint8), size, pixels.shape, 255), _FENCE)
        mask[np.asarray(fence) > 0] = 0
    return Cutout(x0, y0, np.where(mask > 0, pixels, np.uint16(0)))


def _enlarge(
    half: npt.NDArray[_Pixel], size: tuple[int, int], shape: tuple[int, ...], times: int = 1
) -> npt.NDArray[_Pixel]:
    large = np.asarray(cv2.resize(half, size, interpolation=cv2.INTER_NEAREST), dtype=half.dtype)
    return np.ascontiguousarray(large[: shape[0], : shape[1]] * half.dtype.type(times))
