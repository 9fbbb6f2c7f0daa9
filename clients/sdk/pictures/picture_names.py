"""The names of the files into which wallets write pictures.

A robot numbers its frames over a whole visit and from 0; a person, and every command, counts the pictures of one record
from 1. A name says both, and which is which: who reads a number off a file erases the picture in it.
"""

from __future__ import annotations

import re

PICTURE_NAME = (
    r"(?:picture-[0-9]{4,}\.frame-)?(?P<frame>[0-9]{8,})\.(?:depth\.png|png|rgb\.png|rgb\.jpg|label\.json|wav)"
)
"""An expression for all that `name_picture` returns, and for what earlier versions wrote: the robot's frame alone."""
_PICTURE = re.compile(PICTURE_NAME)


def name_picture(index: int, sequence: int, suffix: str) -> str:
    """Return the name of a file: `picture-0005.frame-00000009.png` for the index 4 of the robot's frame 9."""
    return f"picture-{index + 1:04d}.frame-{sequence:08d}.{suffix}"


def is_picture_name(name: str) -> bool:
    """Tell whether a wallet writes, or wrote, a file of this name."""
    return _PICTURE.fullmatch(name) is not None


def read_robot_frame(name: str) -> int:
    """Return which of the robot's frames, counted from 0, a picture's file is of. Raises ValueError for other files."""
    found = _PICTURE.fullmatch(name)
    if found is None:
        raise ValueError(f"{name!r} is no picture's file")
    return int(found["frame"])
