"""The scene of stories that need a recording and no more: one person, ann, with a tag, walks before the robot."""

from __future__ import annotations

from collections.abc import Sequence

UID = "E200000000000001"


def walking_alone(
    name: str,
    duration_s: float,
    path: Sequence[tuple[float, float, float]],
    readings_s: Sequence[float],
    *,
    frame_rate: int = 4,
    size: tuple[int, int] = (640, 480),
    focal_px: float = 525.0,
    also_every_s: float = 0.4,
    distance_sigma_m: float = 0.1,
) -> str:
    """Return the scenario's text. `path` has (s, m to the right, m ahead); `size` is width and height in pixels."""
    return f"""
name = "{name}"
duration_s = {duration_s}
frame_rate = {frame_rate}
width = {size[0]}
height = {size[1]}
focal_px = {focal_px}
camera_height_m = 1.2
seed = 7
empty_frames = 3

[reader]
distance_sigma_m = {distance_sigma_m}
antenna_front = 1
antenna_back = 2
front_misread = 0.0

[[people]]
alias = "ann"
height_m = 1.7
girth = 1.0
cadence = 1.0
path = {[list(step) for step in path]}
readings_s = {list(readings_s)}
also_every_s = {also_every_s}
"""
