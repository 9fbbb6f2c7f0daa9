"""Picture file names, with robot frame number (from 0) and picture number (from 1)."""

from __future__ import annotations

import re

PICTURE_NAME = r"picture-[0-9]{4,}\.frame-(?P<frame>[0-9]{8,})\.(?:depth\.png|png|rgb\.png|rgb\.jpg|label\.json|wav)"
"""An expression for all that `name_picture` returns."""
_PICTURE = re.compile(PICTURE_NAME)


def name_picture(index: int, sequence: int, suffix: str) -> str:
    """E.g. `picture-0005.frame-00000009.png` for index 4, frame 9."""
    return f"picture-{index + 1:04d}.frame-{sequence:08d}.{suffix}"


def is_picture_name(name: str) -> bool:
    return _PICTURE.fullmatch(name) is not None


def read_robot_frame(name: str) -> int:
    """Return the frame's number, from 0. Raises ValueError."""
    found = _PICTURE.fullmatch(name)
    if found is None:
        raise ValueError(f"{name!r} is no picture's file")
    return int(found["frame"])
