"""Sensor events in memory: frames and sightings.

A `Sighting`'s tag UID is never written, logged or sent; only run aliases leave memory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from consensus.errors import BlockRobotError

NS_PER_MS = 1_000_000

DEPTH_WIDTH_MAX_PX = 4096
DEPTH_HEIGHT_MAX_PX = 4096

DISTANCE_MAX_M = 1e6
"""What a reader may tell, in whatever unit it was meant; readings with more count as readings without a distance."""

DISTANCE_SIGMA_MAX_M = 2.0
"""The largest error of a distance that is taken. People whom the camera sees are about as far from each other: a reader
that errs by more does not tell where in a room somebody is, and its readings count as readings without a distance."""

BEARING_SIGMA_MAX_DEG = 45.0
"""The largest error of a bearing that is taken: more than the width of a picture tells nobody in it from anybody else."""

RSSI_UNKNOWN_DBM = 0.0  # no tag answers so loud

Depth = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class Facing(StrEnum):
    """An antenna's direction, seen from the camera."""

    FRONT = "front"
    BACK = "back"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A depth image: uint16 mm, (height, width), 0: no measurement.

    `captured_at_ms` by camera; `received_at_ms` by host or None.
    """

    captured_at_ms: int
    sequence: int
    depth: Depth
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class Sighting:
    """One tag reading over the reader's interval.

    `distance_m` from camera, standard deviation `sigma_m`, None if unknown; `bearing_deg` from the camera's axis, positive
    to the right, and its standard deviation, likewise; `received_at_ms`: host or None; `origin`: topic or reader. UID is
    left out of repr.
    """

    first_seen_ms: int
    last_seen_ms: int
    uid: str = field(repr=False)
    antenna: int = 0
    facing: Facing = Facing.UNKNOWN
    rssi_dbm: float = RSSI_UNKNOWN_DBM
    distance_m: float | None = None
    sigma_m: float | None = None
    bearing_deg: float | None = None
    bearing_sigma_deg: float | None = None
    read_count: int = 1
    received_at_ms: int | None = field(default=None, compare=False)  # the same reading may be reported twice
    origin: str = field(default="", compare=False)

    @property
    def middle_ms(self) -> int:
        return (self.first_seen_ms + self.last_seen_ms) // 2


@dataclass(frozen=True, slots=True)
class Odometry:
    """Where the robot takes itself to be (REP 103): metres ahead and to the left of its start, radians to the left."""

    at_ms: int
    ahead_m: float
    left_m: float
    yaw: float
    received_at_ms: int | None = None


Event = Frame | Sighting | Odometry


@dataclass(frozen=True, slots=True, eq=False)
class ColourFrame:
    """uint8 RGB, (height, width, 3); `registered`: pixel-aligned with depth."""

    at_ms: int
    sequence: int
    pixels: npt.NDArray[np.uint8]
    registered: bool = False
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class Label:
    """An estimate about the person, such as emotion, with any confidence."""

    at_ms: int
    sequence: int
    text: str
    confidence: float | None = None
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class AudioClip:
    """16-bit little-endian interleaved sound, starting at `at_ms`."""

    at_ms: int
    sequence: int
    samples: bytes = field(repr=False)
    rate_hz: int = 16_000
    channels: int = 1
    received_at_ms: int | None = None

    @property
    def ends_ms(self) -> int:
        return self.at_ms + len(self.samples) * 1000 // (2 * self.channels * self.rate_hz)


@dataclass(frozen=True, slots=True)
class RefusedMessage:
    """An unusable message's kind and reason; `detail` never quotes its content."""

    at_ms: int
    kind: str
    reason: str
    detail: str = field(default="", compare=False)


SensorSample = ColourFrame | Label | AudioClip
SourceEvent = Event | SensorSample | RefusedMessage


def is_distance(distance_m: float, sigma_m: float) -> bool:
    """Whether a reader's distance and its error are taken."""
    return 0 < distance_m <= DISTANCE_MAX_M and 0 < sigma_m <= DISTANCE_SIGMA_MAX_M


def check_depth(depth: npt.NDArray[np.generic], *, shape: tuple[int, int] | None = None) -> Depth:
    """Return `depth` if 2-D uint16 (of `shape`). Raises FRAME_INVALID."""
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise BlockRobotError("FRAME_INVALID", "A depth frame must be a two-dimensional image of 16-bit millimetres.")
    height, width = depth.shape
    if not (0 < height <= DEPTH_HEIGHT_MAX_PX and 0 < width <= DEPTH_WIDTH_MAX_PX):
        raise BlockRobotError("FRAME_INVALID", f"A frame of {width}x{height} pixels is empty or too large.")
    if shape is not None and (height, width) != shape:
        raise BlockRobotError(
            "FRAME_INVALID", f"The frame has {width}x{height} pixels where {shape[1]}x{shape[0]} were expected."
        )
    return depth.astype(np.uint16, copy=False)
