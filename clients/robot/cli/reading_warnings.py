"""Warnings about tag readings and camera before a run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from clients.robot.hiding.own_motion import GAP_MAX_MS
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sensing.sensor_events import Facing, Sighting
from clients.robot.sources.messages.field_map import LENGTH_UNITS_M, TagMap
from clients.robot.sources.messages.topics import Topics
from consensus.visible_text import escape_controls

ASSUMED_SIGMA_M = 0.3
READ_EVERY_MS = 500
"""A warning assumes that a tag is read twice a second."""

FORECAST_S = 30
FRAME_EVERY_MS = 100
_STANDS_AT_M = 2.5
_WALKS_M, _WALKS_EVERY_S = 1.0, 8.0  # to and fro by a metre, a turn every eight seconds: about 0.8 m/s at most


def warn_of_readings(topics: Topics) -> Iterator[str]:
    """A sentence per way the readings will keep little."""
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


def warn_of_silence(topics: list[str]) -> Iterator[str]:
    """A sentence per topic of tags that a recording holds no message of."""
    for topic in topics:
        yield f"No reading of a tag comes from {topic}: the recording holds 0 messages of it."


def warn_of_odometry(unnamed: list[str], rate_hz: float | None) -> Iterator[str]:
    """If a recording tells where the robot was, and the topics file does not name it; or if what it names (`rate_hz`, None:
    nothing) tells that too rarely.
    """
    if rate_hz is not None and rate_hz * GAP_MAX_MS < 1_000:
        yield (
            f"The recording has {rate_hz:.1f} places of odometry a second. With fewer than {1_000 // GAP_MAX_MS} it is "
            "mostly unknown where the robot was, and nobody is kept then. Record odometry 10 times a second or more."
        )
    if unnamed:
        names = escape_controls(", ".join(unnamed), allowed="")
        yield (
            f"The recording has odometry ({names}) that the topics file does not name: a robot that drives may pass for "
            "one that stands, and somebody else may be shown. Write [odometry] into the topics file."
        )


def warn_of_lens(focal_px: float | None) -> Iterator[str]:
    """If a recording's focal length is unknown."""
    if focal_px is None:
        yield (
            f"No focal length is known: {FOCAL_DEFAULT_PX:g} pixels are assumed, and people's sizes and distances will be "
            "wrong by as much as that is. Write focal_px into the topics file, or record CameraInfo beside the depth topic."
        )


def _sigma_m(made: TagMap) -> float:
    given = made.distance_sigma
    return given * LENGTH_UNITS_M[made.distance_unit] if isinstance(given, float) else ASSUMED_SIGMA_M


@lru_cache(maxsize=128)
def time_to_bind_s(sigma_m: float, facing: Facing, every_ms: int, *, walks: bool, seed: int = 1) -> float | None:
    """Return seconds until the matcher binds a lone person, None if over `FORECAST_S`; error `sigma_m`."""
    noise = np.random.default_rng(seed)
    matcher, track = Matcher(), Track(1, 0, 0, 0.0, _STANDS_AT_M)
    matcher.add_track(track)
    for at_ms in range(0, FORECAST_S * 1000, FRAME_EVERY_MS):
        turn = math.sin(2 * math.pi * at_ms / 1000 / _WALKS_EVERY_S) if walks else 0.0
        range_m = _STANDS_AT_M + _WALKS_M * turn
        track.times.append(at_ms)
        track.ranges.append(range_m)
        track.bearings.append(0.0)
        track.seen_ms = at_ms
        if at_ms % every_ms == 0:
            distance_m = max(0.01, range_m + float(noise.normal(0.0, sigma_m)))
            matcher.add_sighting("tag", Sighting(at_ms, at_ms, "tag", 0, facing, 0.0, distance_m, sigma_m))
        matcher.advance(at_ms)
        if matcher.bound_track("tag", [1]) is not None:
            return at_ms / 1000
    return None
