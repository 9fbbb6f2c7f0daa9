"""Distance colours, near bright, far dark, grey unmeasured: viridis (Smith, van der Walt, CC0). Integers only, since
pixels are compared.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Depth = npt.NDArray[np.uint16]
Pixels = npt.NDArray[np.uint8]

NEAR_MM, FAR_MM = 400, 8_000
UNMEASURED_GREY = 72
LEGEND_HEIGHT_PX = 44
ANCHORS = (
    *("fde725", "d2e21b", "a5db36", "7ad151", "54c568", "35b779", "22a884", "1f988b", "23888e"),
    *("2a788e", "31688e", "39568c", "414487", "463480", "482173", "471063", "440154"),
)
"""From near to far, at equal distances, as red, green, blue."""
_LEVELS = 256
_NARROW_PX = 320


def _make_table() -> Pixels:
    """Near to far, in OpenCV's channel order."""
    anchors, steps = [bytes.fromhex(each)[::-1] for each in ANCHORS], len(ANCHORS) - 1
    rows = []
    for level in range(_LEVELS):
        index, rest = divmod(level * steps, _LEVELS - 1)
        pair = zip(anchors[index], anchors[min(index + 1, steps)], strict=True)
        rows.append([(a * (_LEVELS - 1 - rest) + b * rest + _LEVELS // 2 - 1) // (_LEVELS - 1) for a, b in pair])
    return np.array(rows, dtype=np.uint8)


_TABLE = _make_table()


def _make_colours() -> Pixels:
    within = np.clip(np.arange(2**16, dtype=np.uint32), NEAR_MM, FAR_MM) - NEAR_MM
    colours = _TABLE[within * (_LEVELS - 1) // (FAR_MM - NEAR_MM)]
    colours[0] = UNMEASURED_GREY
    return colours


_COLOURS = _make_colours()
"""Of every depth in millimetres: looking up is four times as fast as working out."""


def colour_pixels(depth: Depth) -> Pixels:
    """Height x width x 3: blue, green, red."""
    return np.take(_COLOURS, depth, axis=0)


def draw_legend(width: int) -> Pixels:
    strip = np.full((LEGEND_HEIGHT_PX, width, 3), 255, dtype=np.uint8)
    is_narrow = width < _NARROW_PX
    left, right = 12, max(13, int(width * (0.52 if is_narrow else 0.68)))
    strip[6:18, left:right] = _TABLE[np.linspace(0, _LEVELS - 1, right - left).astype(np.uint8)]
    for metres in range(2 if is_narrow else 1, FAR_MM // 1000 + 1, 2 if is_narrow else 1):
        share = (metres * 1000 - NEAR_MM) / (FAR_MM - NEAR_MM)
        _write(strip, f"{metres} m", left + int(share * (right - left)) - 10)
    grey = right + 18
    strip[6:18, grey : grey + 12] = UNMEASURED_GREY
    _write(strip, "not measured", grey)
    return strip


def scale_json() -> dict[str, Any]:
    return {"near_mm": NEAR_MM, "far_mm": FAR_MM, "anchors": list(ANCHORS), "unmeasured": UNMEASURED_GREY}


def scale_css() -> str:
    return f"linear-gradient(90deg, {', '.join(f'#{each}' for each in ANCHORS)})"


def _write(strip: Pixels, text: str, x: int) -> None:
    cv2.putText(strip, text, (x, 34), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (0, 0, 0), 1, cv2.LINE_AA)
