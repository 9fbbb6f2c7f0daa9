"""Warnings about tag readings and camera before a run."""

from __future__ import annotations

from collections.abc import Iterator

from clients.robot.hiding.forecast import time_to_bind_s
from clients.robot.hiding.hider import FOCAL_DEFAULT_PX
from clients.robot.sensing.sensor_events import Facing
from clients.robot.sources.messages.field_map import LENGTH_UNITS_M, TagMap
from clients.robot.sources.topics import Topics

ASSUMED_SIGMA_M = 0.3
READ_EVERY_MS = 500
"""A warning assumes that a tag is read twice a second."""


def warn_of_readings(topics: Topics) -> Iterator[str]:
    """Yield a sentence per way the readings will keep little."""
    measured = [tags for tags in topics.tags if tags.map.distance]
    if not measured:
        named = ", ".join(tags.topic for tags in topics.tags) or "the readers"
        yield (
            f"Readings of {named} have no distance: every frame of their tags will be withheld (no-distance). "
            "Name the distance and distance_sigma in the topics file, or add a topic that measures it."
        )
    for tags in measured:
        if tags.map.knows_facing or any(other.map.knows_facing for other in topics.tags):
            continue
        sigma_m = _sigma_m(tags.map)
        walks_s = time_to_bind_s(sigma_m, Facing.UNKNOWN, READ_EVERY_MS, walks=True)
        walking = f"after about {walks_s:.0f} s" if walks_s is not None else "hardly ever"
        yield (
            f"Nothing says which way the antenna of {tags.topic} looks: nothing will be kept of people who stand still "
            f"(ambiguous), and of those who walk nearer or farther {walking}. Name front and back antennas, or write "
            f'facing = "front" if the reader looks as the camera does.'
        )


def warn_of_lens(focal_px: float | None) -> Iterator[str]:
    """Yield a sentence if a recording's focal length is unknown."""
    if focal_px is None:
        yield (
            f"No focal length is known: {FOCAL_DEFAULT_PX:g} pixels are assumed, and people's sizes and distances will be "
            "wrong by as much as that is. Write focal_px into the topics file, or record CameraInfo beside the depth topic."
        )


def _sigma_m(made: TagMap) -> float:
    told = made.distance_sigma
    return told * LENGTH_UNITS_M[made.distance_unit] if isinstance(told, float) else ASSUMED_SIGMA_M
